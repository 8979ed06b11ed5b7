"""One HTML page of what simbench made, to read, to send, to print.

A page asks nothing of anybody: styles, script, figures and data stand in it, and its content
security policy forbids every request and every script but its own. It holds no date and no path but
those that were given, so equal inputs give equal bytes.

The view in space is drawn by some 150 lines of our own on a plain canvas: points and lines are all
that it shows. A library would bring one to five megabytes (of the six that a page may have) into
every page, or a stranger's code into this repository, and WebGL, which not every viewer has.
"""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path

from simbench.errors import InputError, OutputError
from simbench.files import read_text, replacing
from simbench.report import campaigns, judgements, matrices, runs
from simbench.report.page import Section, html
from simbench.report.saved import (
    Saved,
    SavedAudit,
    SavedMetrics,
    SavedVerdict,
    parse,
)

__all__ = ["report", "sections", "write_report"]

MOST_BYTES = 6 * 10**6


def write_report(paths: Sequence[Path], out: Path) -> tuple[Section, ...]:
    """Write one page on what some files hold, and return its sections.

    Args:
        paths: recordings of runs, what verbs print with `--json`, directories of campaigns.
        out: the HTML file.

    Raises:
        InputError: a file is none of these; says which.
        OutputError: it cannot be written, or would be above 6 MB.
    """
    found = tuple(section for path in paths for section in sections(path))
    page = html(found).encode()
    if len(page) > MOST_BYTES:
        raise OutputError(
            f"Cannot write {out}: expected a page of at most {MOST_BYTES / 1e6:g} MB, got "
            f"{len(page) / 1e6:.1f} MB from {len(found)} sections. Give fewer files to each report."
        )
    with replacing(out) as partial:
        partial.write_bytes(page)
    return found


def report(paths: Sequence[Path]) -> str:
    """The page on what some files hold; raises as `write_report`."""
    return html([section for path in paths for section in sections(path)])


def sections(path: Path) -> Iterator[Section]:
    """What a file has to say, a section for each run, audit, verdict, matrix or campaign."""
    if path.is_dir():
        yield campaigns.campaign(path)
    elif path.suffix == ".mcap":
        yield runs.recording(path)
    else:
        for saved in parse(_json(path), str(path)):
            yield _section(saved, path)


def _section(saved: Saved, path: Path) -> Section:
    match saved:
        case SavedAudit():
            return judgements.audit(saved)
        case SavedVerdict():
            return judgements.verdict(saved)
        case SavedMetrics():
            beside = path.with_suffix(".mcap")
            if beside.exists():
                return runs.recording(beside, saved.values())
            return runs.saved(saved.values())
        case _:
            return matrices.matrix(saved)


def _json(path: Path) -> object:
    try:
        value: object = json.loads(read_text(path))
    except ValueError as error:
        raise InputError(
            f"{path}: expected a recording (.mcap), JSON, or the directory of a campaign: {error}."
        ) from error
    return value
