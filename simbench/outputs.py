"""The files that the verbs leave: which there are, and what they are called."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from simbench.dataset import Dataset
from simbench.errors import InputError
from simbench.files import file_safe, replacing
from simbench.metrics import metrics
from simbench.npz.dialects import DEFAULT, Dialect
from simbench.run import RunOptions, RunRecord, Step, run
from vislam.filters import Factory
from vislam.point import PointSensor


def write_dataset(dataset: Dataset, out: Path, dialect: Dialect = DEFAULT) -> list[Path]:
    """Write NAME.npz (or .npy, as its dialect has it) and NAME.mcap, and return their paths."""
    from simbench.mcap import write_dataset_mcap
    from simbench.npz import write_npz

    npz, mcap = (out / f"{dataset.name}{suffix}" for suffix in (dialect.suffix, ".mcap"))
    if isinstance(dataset.calibration.rig, PointSensor):  # which no dialect can hold
        write_dataset_mcap(mcap, dataset)
        return [mcap]
    write_npz(npz, dataset, dialect)
    write_dataset_mcap(mcap, dataset)
    return [npz, mcap]


def record_run(
    dataset: Dataset,
    name: str,
    factory: Factory,
    out: Path,
    options: RunOptions = RunOptions(),  # noqa: B008 - frozen
    on_step: Callable[[Step], None] = lambda _: None,
) -> tuple[RunRecord, dict[str, Any], list[Path]]:
    """Run a filter and write NAME.FILTER.mcap (while it runs), .json, .tum and the figures.

    Args:
        dataset: the data.
        name: of the filter.
        factory: makes it.
        out: the directory.
        options: what is asked of the run besides.
        on_step: called after each frame.

    Returns:
        The record, its metrics, and the paths.
    """
    from simbench import figures
    from simbench.mcap import record_to
    from simbench.poses import write_tum

    def path(suffix: str) -> Path:
        return out / f"{dataset.name}.{file_safe(name)}{suffix}"

    with record_to(path(".mcap"), dataset, name, asdict(options)) as recorder:

        def both(step: Step) -> None:
            recorder.step(step)
            on_step(step)

        record = run(dataset, factory, name=name, options=options, on_step=both)
        values = metrics(record)
        recorder.finish(record, values)
    write_json(path(".json"), values)
    write_tum(path(".tum"), dataset.times_s, record.T_world_imu)
    pictures = {".trajectory.png": figures.trajectories([record])}
    if dataset.truth is not None:
        pictures[".errors.png"] = figures.errors(record)
    pictures[".consistency.png"] = figures.consistency(record)
    for suffix, figure in pictures.items():
        figures.save(figure, path(suffix))
    return record, values, [path(s) for s in (".mcap", ".json", ".tum", *pictures)]


def filter_of(source: Path) -> str:
    """The filter that a run over a source takes where nobody names one.

    It is the one that a recording says it was made by, so that the run is repeated; else slam.

    Raises:
        InputError: the recording names code of the form ``package.module:factory``, which no file
            may start by itself; or it cannot be read.
    """
    from simbench.mcap import summary
    from simbench.source import Kind, kind_of

    if kind_of(source) is not Kind.RECORDING:
        return "slam"
    name = summary(source).metadata.get("filter") or "slam"
    if ":" in name:
        raise InputError(
            f"{source}: made by the filter {name}, code that a file does not start by itself; "
            f"give a filter: --filter {name}"
        )
    return name


def options_of(source: Path) -> RunOptions | None:
    """The options that a recording was made with, so that the run is repeated; None without any.

    Raises:
        InputError: the recording cannot be read, or its options are none.
    """
    from pydantic import TypeAdapter, ValidationError

    from simbench.mcap import summary
    from simbench.source import Kind, kind_of

    if kind_of(source) is not Kind.RECORDING:
        return None
    text = summary(source).metadata.get("options", "{}")
    if text == "{}":
        return None
    try:
        return TypeAdapter(RunOptions).validate_json(text)
    except ValidationError as error:
        raise InputError(f"{source}: expected the options of a run, got {text[:200]}.") from error


def write_comparison(records: Sequence[RunRecord], out: Path) -> Path:
    """Write NAME.trajectories.png, the runs of several filters side by side."""
    from simbench import figures

    path = out / f"{records[0].dataset.name}.trajectories.png"
    figures.save(figures.trajectories(records), path)
    return path


def write_json(path: Path, value: Mapping[str, Any]) -> None:
    """Write one JSON value, in one piece."""
    with replacing(path) as partial:
        partial.write_text(json.dumps(value, indent=2, allow_nan=False) + "\n", encoding="utf-8")
