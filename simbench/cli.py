"""The verbs of the command line; each is a thin skin over one call of the library.

Libraries are imported inside the verbs, so that ``simbench --help`` answers at once.
"""

import sys
import traceback
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from simbench.checks.defaults import FALSE_ALARM, MOST_SCALARS, RUNS
from simbench.errors import FilterFailure, SimbenchError
from simbench.printing import print_json, progress, show, status
from vislam import __version__

if TYPE_CHECKING:
    from simbench.dataset import Dataset
    from simbench.run import RunRecord

DONE, FAILED, WRONG_INPUT, INTERNAL, INTERRUPTED = 0, 1, 2, 3, 130


class Gate(click.ParamType[float | str]):
    """A probability, or ``none``."""

    name = "P|none"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float | str:
        """The probability as a number in (0, 1)."""
        if value == "none":
            return "none"
        try:
            probability = float(value)
        except ValueError:
            probability = -1.0
        if not 0 < probability < 1:
            self.fail(f"expected a probability between 0 and 1, or none, got {value!r}", param, ctx)
        return probability


_POSITIVE = click.FloatRange(min=0, min_open=True)
_SEED = click.IntRange(0, 2**63 - 1)
_OUT = click.option(
    "--out", type=click.Path(path_type=Path), default=Path("out"), help="Where files go."
)
_JSON = click.option("--json", "as_json", is_flag=True, help="Print one JSON value alone.")
_DEBUG = click.option("--debug", is_flag=True, expose_value=False, help="Show tracebacks.")
_SCENE = (
    click.option("--seed", type=_SEED, help="Default: the scene's own."),
    click.option("--run", type=_SEED, help="Run number, default 0."),
    click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE", help="Change a value."),
)
_CONVENTION = (
    click.option("--imu-frame", type=click.Choice(["flu", "frd"]), help="Overrule what is found."),
    click.option(
        "--extrinsics",
        type=click.Choice(["imu_T_cam", "cam_T_imu", "mixed"]),
        help="Overrule what is found.",
    ),
)
_TOLD = (
    *_SCENE,
    *_CONVENTION,
    click.option("--noise-pixel-px", type=_POSITIVE, help="Sigma a filter is told, pixels."),
    click.option("--noise-velocity", type=_POSITIVE, help="Sigma a filter is told, m/s."),
    click.option("--noise-angular", type=_POSITIVE, help="Sigma a filter is told, rad/s."),
    click.option("--gate", type=Gate(), help="Chi-square gate, or none."),
)


def _options(*options: Callable[..., Any]) -> Callable[..., Any]:
    """Decorate a verb with options, in the order given."""

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        for option in reversed((*options, _JSON, _DEBUG)):
            function = option(function)
        return function

    return decorate


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="simbench")
def cli() -> None:
    """A test bench for visual-inertial filters."""


@cli.command()
@click.argument("scenario", type=click.Path(path_type=Path))
@_options(*_SCENE, _OUT)
def generate(scenario: Path, out: Path, as_json: bool, **told: Any) -> None:
    """Simulate a scene: write OUT/NAME.npz and OUT/NAME.mcap."""
    from simbench.info import describe
    from simbench.outputs import write_dataset

    dataset = _open(scenario, told)
    paths = write_dataset(dataset, out)
    show(describe(dataset) | {"files": list(map(str, paths))}, as_json)


@cli.command()
@click.argument("source", type=click.Path(path_type=Path))
@click.option("--filter", "names", multiple=True, help="A name, or package.module:factory.")
@_options(*_TOLD, _OUT)
def run(source: Path, names: tuple[str, ...], out: Path, as_json: bool, **told: Any) -> None:
    """Run a filter over a scene, a dataset or a recording, and measure it.

    Writes OUT/NAME.FILTER.mcap, .json (metrics), .tum (estimate) and pictures. Without --filter the
    filter is slam, and one more picture shows it beside the paper's other two estimators.
    """
    from simbench.filters import resolve
    from simbench.outputs import record_run, write_comparison
    from simbench.run import run as run_filter

    factories = {name: resolve(name) for name in names or ("slam",)}
    dataset = _open(source, told)
    records: list[RunRecord] = []
    results = []
    for name, factory in factories.items():
        with progress(name, len(dataset)) as on_step:
            record, values, paths = record_run(dataset, name, factory, out, on_step)
        records.append(record)
        results.append((values, paths))
    if not names and dataset.sightings is not None:
        others = ("dead-reckoning", "mapping")
        records = [*(run_filter(dataset, resolve(o), name=o) for o in others), *records]
    if len(records) > 1:
        results[-1][1].append(write_comparison(records, out))
    if as_json:
        print_json([v for v, _ in results] if len(results) > 1 else results[0][0])
    else:
        for values, paths in results:
            show(values | {"files": list(map(str, paths))}, as_json=False)


@cli.command()
@click.argument("file", type=click.Path(path_type=Path))
@_options(*_CONVENTION)
def info(file: Path, as_json: bool, **told: Any) -> None:
    """Say what a file is: sizes, rates, statistics, convention, what is wrong with it."""
    from simbench.info import info as describe_file
    from simbench.source import Told

    show(describe_file(file, Told(**told)), as_json)


@cli.command()
@click.option("--filter", "names", multiple=True, required=True, help="May be repeated.")
@click.option("--scene", type=click.Path(path_type=Path), help="Default: the built-in scenes.")
@click.option(
    "--most-scalars",
    type=click.IntRange(min=16),
    help=f"Of --scene, default {MOST_SCALARS}; 2000 take minutes.",
)
@_options(*_SCENE)
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
        else (ShortDrive.of(_open(scene, told), most_scalars or MOST_SCALARS),)
    )
    results = {name: audit_filter(resolve(name), drives) for name in names}
    if as_json:
        values = [{"filter": name, **result.as_json()} for name, result in results.items()]
        print_json(values if len(values) > 1 else values[0])
    else:
        for name, result in results.items():
            click.echo(f"{name}: {'passed' if result.passed else 'failed'}")
            for each in result.scenes:
                click.echo(f"  {each.scene}: {each}")
    return DONE if all(result.passed for result in results.values()) else FAILED


@cli.command()
@click.option("--filter", "name", required=True, help="A name, or package.module:factory.")
@click.option("--check", default="audit", help="What it must pass, default: audit.")
@click.option("--seed", type=_SEED, default=0, help="Of the search.")
@click.option("--max-seconds", type=_POSITIVE, default=60.0, help="Then the smallest so far.")
@_options(_OUT)
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


@cli.command()
@click.option("--matrix", "measure", is_flag=True, help="Measure which check catches which.")
@click.option("--fast", is_flag=True, help="Only the checks of which one run tells.")
@click.option("--runs", type=click.IntRange(min=100), help="Of the other checks, default 400.")
@click.option("--out", type=click.Path(path_type=Path), help="Write bugs.png, a heat map.")
@_options()
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


@cli.command()
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
@_options(_SCENE[0], _SCENE[2])
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
    from simbench.checks.verdict import check as judge
    from simbench.scenario import load

    scene = load(scenario, overrides)
    verdicts = {
        name: judge(scene, name, runs=runs, false_alarm=false_alarm, seed=seed, jobs=jobs or -1)
        for name in names
    }
    if as_json:
        values = [{"filter": name, **each.as_json()} for name, each in verdicts.items()]
        print_json(values if len(values) > 1 else values[0])
    else:
        for name, each in verdicts.items():
            click.echo(f"{name}: {'passed' if each.passed else 'failed'}")
            for line in each.lines():
                click.echo(f"  {line}")
    return DONE if all(each.passed for each in verdicts.values()) else FAILED


LISTS = ("filters", "checks", "trajectories", "landmarks", "bugs", "schema")


@cli.command("list")
@click.argument("what", type=click.Choice(LISTS))
@_options()
def list_(what: str, as_json: bool) -> None:
    """Say what there is, a line each; schema is the JSON schema of a scene file."""
    if what == "schema":
        from simbench.scenario import schema

        click.echo(schema.text(), nl=False)
        return
    table = _table(what)
    if as_json:
        print_json(table)
    else:
        width = max(map(len, table))
        for name, about in table.items():
            click.echo(f"{name:{width}}  {about}")


def _table(what: str) -> Mapping[str, str]:
    if what == "filters":
        from simbench.filters import known

        return known()
    if what == "checks":
        from simbench.checks.conformance import CHECKS

        return CHECKS
    if what == "bugs":
        from simbench.bugs import BUGS

        return {name: bug.what for name, bug in BUGS.items()}
    from simbench.scenario import LANDMARKS, TRAJECTORIES

    return TRAJECTORIES if what == "trajectories" else LANDMARKS


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


def _open(path: Path, told: Mapping[str, Any]) -> "Dataset":
    """Open a source and say on standard error what its reader found."""
    from simbench.source import Told, open_source

    dataset = open_source(path, Told(**told))
    for note in dataset.notes:
        click.echo(note, err=True)
    return dataset


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a verb and return its exit status."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    try:
        exit_status = cli.main(arguments, prog_name="simbench", standalone_mode=False)
    except (KeyboardInterrupt, click.Abort):
        return _failed(INTERRUPTED, "Interrupted; finished files are whole, unfinished ones gone.")
    except click.ClickException as error:
        error.show()
        return WRONG_INPUT
    except Exception as error:
        if "--debug" in arguments:
            traceback.print_exc()
        if isinstance(error, FilterFailure):
            return _failed(FAILED, f"The filter failed: {error}")
        if isinstance(error, SimbenchError):
            return _failed(WRONG_INPUT, str(error))
        return _failed(
            INTERNAL, f"Internal error, {type(error).__name__}: {error}. --debug shows where."
        )
    return exit_status or DONE  # a judging verb returns its own


def _failed(status: int, message: str) -> int:
    click.echo(message, err=True)
    return status
