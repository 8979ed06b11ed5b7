"""The verbs that run studies of many runs, and compare what comes of them."""

from pathlib import Path
from typing import Any

import click

from simbench.cli.options import DONE, FAILED, INTERRUPTED, OUT, POSITIVE, SCENE, options
from simbench.printing import print_json, rows_progress


@click.command()
@click.argument("study", type=click.Path(path_type=Path))
@click.option("--filter", "filters", multiple=True, help="May be repeated; default: the study's.")
@click.option("--runs", type=click.IntRange(min=1), help="Of each case; default: the study's, 50.")
@click.option("--time-limit", "time_limit_s", type=POSITIVE, help="Of a filter on a run, seconds.")
@click.option("--backend", type=click.Choice(["local", "dask", "ray"]), default="local")
@click.option("--scheduler", metavar="ADDRESS", help="Of the Dask scheduler or Ray cluster.")
@click.option("--jobs", type=click.IntRange(min=1), help="Processes, default: all cores.")
@options(SCENE[0], SCENE[2], OUT)
def campaign(
    study: Path,
    overrides: tuple[str, ...],
    out: Path,
    as_json: bool,
    backend: Any,
    scheduler: str | None,
    jobs: int | None,
    **changes: Any,
) -> int:
    """Run filters over many runs of scenes, all of them on the same data.

    STUDY is a study file, or a scenario. Writes OUT/results.csv, a row a run and filter, and
    OUT/summary.json, and prints what compare does. The same command goes on with what was
    interrupted.
    """
    from simbench.campaign import campaign as conduct
    from simbench.campaign import load

    told = {key: value for key, value in changes.items() if value not in (None, ())}
    plan = load(study, overrides, told)
    try:
        with rows_progress(plan.study.name) as on_progress:
            summary = conduct(
                plan, out, backend=backend, scheduler=scheduler, jobs=jobs, on_progress=on_progress
            )
    except KeyboardInterrupt:
        click.echo(f"Interrupted; finished rows are in {out}; the same command goes on.", err=True)
        return INTERRUPTED
    if as_json:
        print_json(summary)
    else:
        _echo(summary, "text")
        for check in summary["checks"]:
            click.echo("{filter}: {name}: {outcome}: {reason}".format(**check))
        click.echo(f"{out / 'results.csv'}")
    return FAILED if any(check["failure"] == "mistake" for check in summary["checks"]) else DONE


@click.command()
@click.argument("results", type=click.Path(path_type=Path), nargs=-1, required=True)
@click.option("--format", "form", type=click.Choice(["text", "markdown", "latex"]), default="text")
@options()
def compare(results: tuple[Path, ...], form: str, as_json: bool) -> None:
    """Compare filters by the results of campaigns, or by the metrics of runs.

    RESULTS are the --out of campaigns, tables in it (.csv, .parquet), or what run wrote (.json).
    Filters that ran on the same data are compared run by run.
    """
    from simbench.compare import compare as summarise

    summary = summarise(results)
    if as_json:
        print_json(summary)
    else:
        _echo(summary, form)


def _echo(summary: dict[str, Any], form: str) -> None:
    from simbench.compare import FORMATS, tables

    for table in tables(summary):
        for line in FORMATS[form](table):
            click.echo(line)
        click.echo()
