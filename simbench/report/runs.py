"""Sections on runs of a filter."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from simbench import figures
from simbench.mcap import RecordedRun, read_run_mcap
from simbench.report.meaning import command
from simbench.report.numbers import number
from simbench.report.page import Block, Layer, Picture, Section, Text, View, table
from simbench.run import RunRecord
from vislam.arrays import Array

#: Points of a line and of a cloud in a view; more than a screen can show.
MOST_ON_A_LINE, MOST_DOTS = 3000, 8000

#: What the metrics are, and what a right filter has.
METRICS: Mapping[str, tuple[str, str, str]] = {
    "frames": ("frames", "", ""),
    "landmarks": ("landmarks that were ever in the state", "", ""),
    "duration_s": ("duration", "s", ""),
    "wall_s": ("time in the filter's own calls", "s", ""),
    "realtime_factor": ("duration over that time", "", "above 1 to keep up"),
    "path_length_m": ("length of the path", "m", ""),
    "ate_rmse_m": ("absolute error of the positions, not aligned, RMS", "m", ""),
    "ate_rmse_aligned_m": ("the same after the best rigid motion", "m", ""),
    "rpe_trans_rmse_m": ("error of the motion from frame to frame, RMS", "m", ""),
    "rpe_rot_rmse_deg": ("the same of the rotation", "°", ""),
    "final_position_error_m": ("error of the last position", "m", ""),
    "final_rotation_error_deg": ("error of the last rotation", "°", ""),
    "pose_nees_mean": (
        "squared error of the pose over its covariance, mean",
        "",
        "6 over many runs",
    ),
    "landmark_nees_mean": ("the same of the landmarks at the end", "", "3 over many runs"),
    "landmark_rmse_m": ("error of the landmarks at the end, RMS", "m", ""),
    "nis_mean_per_dof": ("squared innovation over its covariance, per degree", "", "1"),
    "smoothed_ate_rmse_m": ("smoothed: absolute error, not aligned, RMS", "m", ""),
    "smoothed_ate_rmse_aligned_m": ("smoothed: after the best rigid motion", "m", ""),
    "smoothed_rpe_trans_rmse_m": ("smoothed: from frame to frame, RMS", "m", ""),
    "smoothed_rpe_rot_rmse_deg": ("smoothed: the same of the rotation", "°", ""),
    "smoothed_pose_nees_mean": ("smoothed: NEES of the pose, mean", "", "6 over many runs"),
    "accepted": ("sightings that were used", "", ""),
    "rejected": ("sightings that were refused", "", ""),
    "rejected_share": ("the share of those that were tested", "", "1 less the gate"),
    "skipped_features": ("invalid features that were met", "", ""),
}


def recording(path: Path, more: Mapping[str, Any] | None = None) -> Section:
    """The section on a recording.

    Args:
        path: of the MCAP file.
        more: metrics that lie beside it, wall-clock times included.
    """
    found = read_run_mcap(path)
    record = found.record
    metrics = dict(more or found.metrics)
    return Section(
        kind="run",
        title=f"{metrics.get('source', record.dataset.name)}, {record.filter}",
        passed=None,
        verdict=_headline(metrics, finished=bool(found.metrics)),
        again=(command("run", str(path), "--filter", record.filter),),
        facts=_facts(record),
        blocks=(*_pictures(found), *_metrics(metrics), *_scene(record)),
    )


def saved(metrics: Mapping[str, Any]) -> Section:
    """The section on the metrics of a run whose recording is not there."""
    source, filter_ = str(metrics["source"]), str(metrics["filter"])
    return Section(
        kind="run",
        title=f"{source}, {filter_}",
        passed=None,
        verdict=_headline(metrics, finished=True),
        again=(command("run", source, "--filter", filter_),),
        facts={"source": source, "filter": filter_},
        blocks=tuple(_metrics(metrics)),
    )


def _headline(metrics: Mapping[str, Any], *, finished: bool) -> str:
    """What one would say first."""
    if not finished:
        return "The recording is unfinished: the run was interrupted."
    parts = []
    if (ate := metrics.get("ate_rmse_m")) is not None:
        length = metrics.get("path_length_m")
        way = "" if length is None else f" on {number(length)} m"
        parts.append(f"Absolute error {number(ate)} m{way}.")
    if (nees := metrics.get("pose_nees_mean")) is not None:
        parts.append(f"Mean NEES of the pose {number(nees)}, where a right filter has 6.")
    if (nis := metrics.get("nis_mean_per_dof")) is not None:
        parts.append(f"NIS {number(nis)} per degree of freedom, where it has 1.")
    if (fit := metrics.get("noise_fit")) is not None:
        parts.append(str(fit))
    return " ".join(parts) or "There is no truth and no innovation to measure by."


def _facts(record: RunRecord) -> dict[str, str]:
    dataset, origin = record.dataset, record.dataset.origin
    facts = {"data": dataset.name, "filter": record.filter, "frames": str(len(record.steps))}
    if origin is not None:
        facts |= {"seed": str(origin.seed), "run": str(origin.run)}
        facts["simulated by"] = f"simbench {origin.version}"
    facts["gate"] = "none" if dataset.gate is None else number(dataset.gate)
    return facts | {f"note {i}": note for i, note in enumerate(dataset.notes, 1)}


def _pictures(found: RecordedRun) -> Iterator[Block]:
    record = found.record
    times_s = record.dataset.times_s[: len(record.steps)]
    yield View(layers=tuple(layers(record)), caption="The path and the map.")
    yield Picture(
        figure=figures.trajectories([replace(record, filter="estimate")]),
        caption="The same from above. Far landmarks may lie outside.",
    )
    no_pose = "no truth" if record.dataset.truth is None else "no pose covariance"
    yield Picture(
        figure=figures.consistency_over_time(
            "this run",
            times_s - times_s[0],
            found.nees if np.isfinite(found.nees).any() else no_pose,
            (found.nis, found.nis_dof) if found.nis_dof.any() else "no innovations",
        ),
        caption="Squared errors and innovations over the covariance that was claimed for them. "
        "Above the band the filter is too sure, below it not sure enough.",
    )
    if record.dataset.truth is not None:
        yield Picture(
            figure=figures.errors(record, ("p", r"\theta")),
            caption="Errors of the pose along and about the axes of the map, and three standard "
            "deviations of what the filter claims.",
        )


def layers(record: RunRecord) -> Iterator[Layer]:
    """What is to be seen of a run in space."""
    truth, final = record.dataset.truth, record.final.landmarks
    if truth is not None:
        landmarks = _thinned(truth.landmarks, MOST_DOTS)
        yield Layer(name="true landmarks", shape="dots", color="--grey", points=landmarks)
    if len(final):
        points = _thinned(final[np.isfinite(final).all(axis=1)], MOST_DOTS)
        yield Layer(name="estimated landmarks", shape="dots", color="--vermillion", points=points)
    path = _thinned(record.T_world_imu[:, :3, 3], MOST_ON_A_LINE)
    yield Layer(name="estimated path", shape="line", color="--blue", points=path)
    if record.smoothed is not None:
        path = np.array([belief.T_world_imu[:3, 3] for belief in record.smoothed])
        points = _thinned(path, MOST_ON_A_LINE)
        yield Layer(name="smoothed path", shape="line", color="--good", points=points)
    if truth is not None:
        path = _thinned(truth.T_world_imu[: len(record.steps), :3, 3], MOST_ON_A_LINE)
        yield Layer(name="true path", shape="line", color="--ink", points=path, dashed=True)


def _thinned(points: Array, most: int) -> Array:
    """At most so many of them, evenly, the first and the last among them."""
    if len(points) <= most:
        return points
    kept: Array = points[np.linspace(0, len(points) - 1, most).round().astype(int)]
    return kept


def _metrics(metrics: Mapping[str, Any]) -> Iterator[Block]:
    known = [name for name in METRICS if name in metrics]
    rows = [
        (about, metrics[name], unit, expected, name)
        for name in dict.fromkeys([*known, *metrics])
        if isinstance(metrics[name], int | float)
        for about, unit, expected in [METRICS.get(name, ("", "", ""))]
    ]
    yield table("Measured", ("what", "value", "unit", "a right filter has", "name"), rows)


def _scene(record: RunRecord) -> Iterator[Block]:
    if (origin := record.dataset.origin) is not None:
        yield Text(title="The scene, whole", text=origin.scenario_yaml)
