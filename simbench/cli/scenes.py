"""The verbs that make and run scenes, and look at files."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from simbench.cli.options import CONVENTION, OUT, PAST, SCENE, TOLD, open_dataset, options
from simbench.printing import print_json, progress, show

if TYPE_CHECKING:
    from simbench.run import RunRecord


@click.command()
@click.argument("scenario", type=click.Path(path_type=Path))
@click.option("--dialect", help="Of the .npz, default 2022; see `simbench convert --help`.")
@options(*SCENE, OUT)
def generate(scenario: Path, dialect: str | None, out: Path, as_json: bool, **told: Any) -> None:
    """Simulate a scene: write OUT/NAME.npz and OUT/NAME.mcap.

    With --dialect 2025 the dataset is OUT/NAME.npy, a pickled dict.
    """
    from simbench.convert import lost_in
    from simbench.info import describe
    from simbench.npz.dialects import DEFAULT, Dialect
    from simbench.outputs import write_dataset

    written = Dialect.named(dialect) if dialect else DEFAULT
    dataset = open_dataset(scenario, told)
    for line in lost_in(dataset, written):
        click.echo(f"Not in {dataset.name}{written.suffix}: {line}.", err=True)
    paths = write_dataset(dataset, out, written)
    show(describe(dataset) | {"files": list(map(str, paths))}, as_json)


@click.command()
@click.argument("source", type=click.Path(path_type=Path))
@click.option("--filter", "names", multiple=True, help="A name, or package.module:factory.")
@options(*TOLD, *PAST, OUT)
def run(
    source: Path,
    names: tuple[str, ...],
    smooth: bool,
    memory: int | None,
    retire_after: int | None,
    landmarks: str | None,
    out: Path,
    as_json: bool,
    **told: Any,
) -> None:
    """Run a filter over a scene, a dataset or a recording, and measure it.

    Writes OUT/NAME.FILTER.mcap, .json (metrics), .tum (estimate) and pictures. Without --filter the
    filter is slam, or of a run's recording its own, and makes the same numbers again; and one more
    picture shows it beside the paper's other estimators.
    """
    from simbench.filters import resolve
    from simbench.outputs import filter_of, options_of, record_run, write_comparison
    from simbench.run import RunOptions, prepared
    from simbench.run import run as run_filter

    factories = {name: resolve(name) for name in names or (filter_of(source),)}
    opened = open_dataset(source, told)
    recorded = options_of(source)  # of a run, whose data are those that its filter was fed
    dataset, recorded = (opened, recorded) if recorded else prepared(opened)
    asked = RunOptions(
        smooth=smooth or recorded.smooth,
        memory_bytes=memory or recorded.memory_bytes,
        retire_after=retire_after or recorded.retire_after,
        inverse_depth=landmarks == "inverse-depth" if landmarks else recorded.inverse_depth,
    )
    for note in dataset.notes[len(opened.notes) :]:
        click.echo(note, err=True)
    records: list[RunRecord] = []
    results = []
    for name, factory in factories.items():
        with progress(name, len(dataset)) as on_step:
            record, values, paths = record_run(dataset, name, factory, out, asked, on_step)
        records.append(record)
        results.append((values, paths))
    if not names and dataset.sightings is not None:
        others = {"dead-reckoning", "mapping"} - factories.keys()
        records = [*(run_filter(dataset, resolve(o), name=o) for o in sorted(others)), *records]
    if len(records) > 1:
        results[-1][1].append(write_comparison(records, out))
    if as_json:
        print_json([v for v, _ in results] if len(results) > 1 else results[0][0])
    else:
        for values, paths in results:
            show(values | {"files": list(map(str, paths))}, as_json=False)


@click.command()
@click.argument("file", type=click.Path(path_type=Path))
@options(*CONVENTION)
def info(file: Path, as_json: bool, **told: Any) -> None:
    """Say what a file is: sizes, rates, statistics, convention, what is wrong with it."""
    from simbench.info import info as describe_file
    from simbench.source import Told

    show(describe_file(file, Told(**told)), as_json)
