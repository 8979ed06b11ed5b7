"""The verbs that judge filters."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from simbench.checks.defaults import FALSE_ALARM, MOST_SCALARS, RUNS
from simbench.cli.options import (
    DONE,
    FAILED,
    INTERRUPTED,
    OUT,
    POSITIVE,
    SCENE,
    SEED,
    open_dataset,
    options,
)
from simbench.printing import print_json, show, status


@click.command()
@click.option("--filter", "names", multiple=True, required=True, help="May be repeated.")
@click.option("--scene", type=click.Path(path_type=Path), help="Default: the built-in scenes.")
@click.option(
    "--most-scalars",
    type=click.IntRange(min=16),
    help=f"Of --scene, default {MOST_SCALARS}; 2000 take minutes.",
)
@options(*SCENE)
def audit(
    names: tuple[str, ...], scene: Path | None, most_scalars: int | None, as_json: bool, **told: Any
) -> int:
    """Audit a filter exactly: does it claim the covariance that its errors have?

    Prints the first call and block that deviate. Of a --scene, as many leading frames take part as
    have at most --most-scalars numbers of noise; it alone takes --seed, --run and --set.
    """
    if scene is None:
        _refuse_without_scene(most_scalars, told)
    from simbench.checks.audit import audit as audit_filter
    from simbench.checks.short_drive import ShortDrive
    from simbench.filters import resolve

    drives = (
        None
        if scene is None
        else (ShortDrive.of(open_dataset(scene, told), most_scalars or MOST_SCALARS),)
    )
    results = {name: audit_filter(resolve(name), drives) for name in names}
    if as_json:
        made = {
            "scenario": None if scene is None else str(scene),
            "most_scalars": most_scalars,
            "seed": told["seed"],
            "run": told["run"],
            "set": list(told["overrides"]),
        }
        values = [{"filter": name, **made, **result.as_json()} for name, result in results.items()]
        print_json(values if len(values) > 1 else values[0])
    else:
        for name, result in results.items():
            click.echo(f"{name}: {'passed' if result.passed else 'failed'}")
            for each in result.scenes:
                click.echo(f"  {each.scene}: {each}")
    return DONE if all(result.passed for result in results.values()) else FAILED


@click.command()
@click.option("--filter", "name", required=True, help="A name, or package.module:factory.")
@click.option("--check", default="audit", help="What it must pass, default: audit.")
@click.option("--seed", type=SEED, default=0, help="Of the search.")
@click.option("--max-seconds", type=POSITIVE, default=60.0, help="Then the smallest so far.")
@options(OUT)
def hunt(name: str, check: str, seed: int, max_seconds: float, out: Path, as_json: bool) -> int:
    """Search scenes for one where a filter fails a check, and shrink it to the smallest.

    Writes OUT/hunt-CHECK-FILTER.yaml and .mcap; audit --scene shows it again. Of slam+BUG, slam
    passes there. An interrupted hunt keeps the smallest scene so far.
    """
    from simbench import hunt as hunting
    from simbench.filters import resolve

    factory, judge, clean = resolve(name), hunting.judge(check), hunting.clean_of(name)
    with hunting.nothing_left_behind(), status(f"hunting for a scene where {name} fails"):
        result = hunting.hunt(factory, judge, clean=clean, seed=seed, max_seconds=max_seconds)
    found = result.found
    values: dict[str, Any] = {
        "found": found is not None,
        "scenario": None,
        "mcap": None,
        "frames": found and found.frames,
        "landmarks": found and found.landmarks,
        "check": check,
        "reason": found and found.reason,
        "test": None,
        "tried": result.tried,
        "ended": result.ended,
    }
    if found is not None:
        scenario, recording = hunting.write(found, name, check, out)
        values |= {"scenario": str(scenario), "mcap": str(recording)}
        values["test"] = hunting.line_for_test(scenario, name, check)
    show(values, as_json)
    if result.ended == "interrupted":
        return INTERRUPTED
    return DONE if found is None else FAILED


@click.command()
@click.option("--matrix", "measure", is_flag=True, help="Measure which check catches which.")
@click.option("--fast", is_flag=True, help="Only the checks of which one run tells.")
@click.option("--runs", type=click.IntRange(min=100), help="Of the other checks, default 400.")
@click.option("--out", type=click.Path(path_type=Path), help="Write bugs.png, a heat map.")
@options()
def bugs(measure: bool, fast: bool, runs: int | None, out: Path | None, as_json: bool) -> int:
    """Say what mistakes there are to judge a bench by, and what must catch each.

    slam+NAME names a filter with the mistake in it, wherever a filter is named. With --matrix, x is
    a check that catches a mistake, and ! one that should and does not, or that catches a control. A
    check that needs many runs says how often 20 of them catch it (more runs give better figures),
    the last column how many times the ATE is that of the filter without the mistake.
    """
    from simbench.bugs import BUGS

    if measure:
        from simbench.bugs.matrix import RUNS, matrix, missed, table

        found = matrix(runs=0 if fast else runs or RUNS)
        if out is not None:
            from simbench import figures

            figures.save(figures.bugs(found), out / "bugs.png")
        if as_json:
            print_json(
                {n: {c: cell.as_json() for c, cell in row.items()} for n, row in found.items()}
            )
        else:
            click.echo(table(found))
        return FAILED if any(missed(name, row) for name, row in found.items()) else DONE
    if as_json:
        print_json([{"name": name, **bug.as_json()} for name, bug in BUGS.items()])
        return DONE
    for name, bug in BUGS.items():
        click.echo(f"{name}  {bug.what}")
        click.echo(f"  source     {bug.source}")
        click.echo(f"  base       {bug.base}")
        click.echo(f"  caught by  {', '.join(bug.checks) or 'none: a control'}")
        click.echo(f"  audit      {bug.audit or f'blind: {bug.blind}'}")
    return DONE


@click.command()
@click.argument("scenario", type=click.Path(path_type=Path))
@click.option("--filter", "names", multiple=True, required=True, help="May be repeated.")
@click.option("--runs", type=click.IntRange(min=1), default=RUNS, help=f"Default: {RUNS}.")
@click.option(
    "--false-alarm",
    type=click.FloatRange(0, 1, min_open=True, max_open=True),
    default=FALSE_ALARM,
    help=f"Of the whole verdict, default {FALSE_ALARM}.",
)
@click.option("--jobs", type=click.IntRange(min=1), help="Processes, default: all cores.")
@options(SCENE[0], SCENE[2])
def check(
    scenario: Path,
    names: tuple[str, ...],
    runs: int,
    false_alarm: float,
    jobs: int | None,
    seed: int | None,
    overrides: tuple[str, ...],
    as_json: bool,
) -> int:
    """Judge a filter in a scene by all instruments: exact audit, then many runs at its noise.

    Every check by chance is corrected for their number, and two-sided except for whiteness, where
    only too much counts. A failed check says what its failure usually means, and the conclusion
    what they mean together.
    """
    from simbench.checks.instruments import check as judge
    from simbench.scenario import load

    scene = load(scenario, overrides)
    verdicts = {
        name: judge(scene, name, runs=runs, false_alarm=false_alarm, seed=seed, jobs=jobs or -1)
        for name in names
    }
    if as_json:
        made = {
            "scenario": str(scenario),
            "seed": scene.seed if seed is None else seed,
            "set": list(overrides),
        }
        values = [{"filter": name, **made, **each.as_json()} for name, each in verdicts.items()]
        print_json(values if len(values) > 1 else values[0])
    else:
        for name, each in verdicts.items():
            click.echo(f"{name}: {'passed' if each.passed else 'failed'}")
            for line in each.lines():
                click.echo(f"  {line}")
    return DONE if all(each.passed for each in verdicts.values()) else FAILED


def _refuse_without_scene(most_scalars: int | None, told: Mapping[str, Any]) -> None:
    """Refuse options of an audit that would be silently without effect."""
    options = {
        "--most-scalars": most_scalars,
        "--seed": told["seed"],
        "--run": told["run"],
        "--set": told["overrides"] or None,
    }
    for option, value in options.items():
        if value is not None:
            raise click.UsageError(
                f"{option} goes with --scene; without one the built-in scenes are audited."
            )
