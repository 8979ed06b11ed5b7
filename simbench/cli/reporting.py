"""The verb that makes a page to read of what the others left."""

from pathlib import Path

import click

from simbench.cli.options import options
from simbench.printing import show


@click.command()
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("out/report.html"),
    help="Default: out/report.html.",
)
@options()
def report(files: tuple[Path, ...], out: Path, as_json: bool) -> None:
    """Make one HTML page of runs, audits, verdicts, bug matrices and campaigns.

    A file is the .mcap of a run or the .json beside it, what audit, check or bugs --matrix print
    with --json, or the directory of a campaign. The page stands alone: nothing is loaded from
    anywhere.
    """
    from simbench.report import write_report

    sections = write_report(files, out)
    judged = [
        {"kind": section.kind, "title": section.title, "outcome": section.outcome}
        for section in sections
    ]
    show({"file": str(out), "bytes": out.stat().st_size, "sections": judged}, as_json)
