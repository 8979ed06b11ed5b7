"""Pictures of runs."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from simbench.errors import InputError
from simbench.figures.drawing import (
    BLUE,
    COLUMN_WIDTH_IN,
    GREY,
    PROBABILITY,
    RASTERIZE_ABOVE,
    TEXT_WIDTH_IN,
    VERMILLION,
    band,
    legend,
    plain,
    say,
    styled,
)
from simbench.metrics import ate, chi_square_band, nis, pose_nees, rmse
from simbench.run import RunRecord
from vislam.arrays import Array, IntArray

BAND = f"{100 * PROBABILITY:.0f} % band"


@styled
def trajectories(records: Sequence[RunRecord]) -> Figure:
    """Estimated paths and maps from above beside the truth, a panel for each run.

    All panels show the same part of the world: all of the paths and of the true landmarks, and the
    middle 96 % of the estimated ones along either axis, so that a few far ones do not shrink the
    rest.
    """
    if not records:
        raise InputError("Expected at least one run to draw, got none.")
    columns = min(len(records), 3)
    rows = -(-len(records) // columns)
    low, high = _view(records)
    width = TEXT_WIDTH_IN if columns > 1 else COLUMN_WIDTH_IN
    shape = float(np.clip((high - low)[1] / (high - low)[0], 0.4, 1.5))
    panel = (width - 0.5) / columns - 0.1  # what labels leave of the width
    legend_height = 0.4 if columns > 1 else 0.6  # one line, two lines
    size = width, rows * (shape * panel + 0.55) + legend_height
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for ax, record in zip(axes.flat, records, strict=False):
        _draw_map(ax, record)
        ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    for ax in axes.flat[len(records) :]:
        ax.remove()
    for ax in axes[:, 0]:
        ax.set_ylabel("y [m]")
    for ax in axes.flat[max(len(records) - columns, 0) : len(records)]:
        ax.set_xlabel("x [m]")
        ax.tick_params(labelbottom=True)
    legend(figure)
    return figure


def _draw_map(ax: Axes, record: RunRecord) -> None:
    """One panel of `trajectories`."""
    truth, path = record.dataset.truth, record.T_world_imu[:, :2, 3]
    title = plain(record.filter)
    ax.plot(*path.T, color=BLUE, linewidth=1.4, zorder=3, label="estimated path")
    if truth is not None:
        true_path = truth.T_world_imu[:, :2, 3].T
        ax.plot(*true_path, "k", dashes=(4, 2), linewidth=0.9, zorder=3, label="true path")
        title += f", ATE {rmse(ate(record.T_world_imu, truth.T_world_imu).translation_m):.3g} m"
    ax.plot(*path[0], "k^", markerfacecolor="w", markersize=4, zorder=4, label="start")
    ax.plot(*path[-1], "ks", markerfacecolor="none", markersize=7, zorder=4, label="end")
    if len(record.final.landmarks):
        _dots(ax, record.final.landmarks, "o", VERMILLION, "estimated landmark")
    if truth is not None:
        _dots(ax, truth.landmarks, "x", GREY, "true landmark")
    ax.set_title(title)


def _dots(ax: Axes, landmarks: Array, marker: str, color: str, label: str) -> None:
    """Landmarks from above; the more there are, the smaller."""
    ax.plot(
        *landmarks[:, :2].T,
        linestyle="none",
        marker=marker,
        color=color,
        zorder=2.2 if marker == "o" else 2.1,
        markersize=np.clip(40 / np.sqrt(max(len(landmarks), 1)), 1, 3.5),
        markeredgewidth=0.0 if marker == "o" else 0.6,
        label=label,
        rasterized=len(landmarks) > RASTERIZE_ABOVE,
    )


def _view(records: Sequence[RunRecord]) -> tuple[Array, Array]:
    """The corners of what `trajectories` shows."""
    shown = [record.T_world_imu[:, :2, 3] for record in records]
    for record in records:
        if (truth := record.dataset.truth) is not None:
            shown += [truth.T_world_imu[:, :2, 3], truth.landmarks[:, :2]]
        if len(landmarks := record.final.landmarks):
            shown.append(np.percentile(landmarks[:, :2], [2, 98], axis=0))
    points = np.concatenate(shown)
    low, high = points.min(axis=0), points.max(axis=0)
    margin = max(0.05 * float((high - low).max()), 0.5)
    return low - margin, high + margin


@styled
def errors(record: RunRecord, symbols: tuple[str, str] = (r"\rho", r"\phi")) -> Figure:
    """The error of the pose with its 3-sigma bands over time, in the filter's own chart, by axis.

    Without truth the bands alone are drawn, without a covariance the error alone: the legend says
    so.

    Args:
        record: the run.
        symbols: what the chart calls the error of translation and that of rotation.
    """
    times_s, error, covariances = _times(record), record.pose_errors, record.pose_covariances
    in_units = np.repeat([1.0, 180 / np.pi], 3)
    figure = Figure(figsize=(TEXT_WIDTH_IN, 4.2), layout="constrained")
    axes = figure.subplots(3, 2, sharex=True)
    for k, ax in enumerate(axes.T.flat):
        if covariances is not None:
            bound = 3 * in_units[k] * np.sqrt(np.maximum(covariances[:, k, k], 0))
            band(ax, times_s, -bound, bound, r"$\pm 3\sigma$" + ", no truth" * (error is None))
        if error is not None:
            label = "error" + ", no covariance" * (covariances is None)
            ax.plot(times_s, in_units[k] * error[:, k], color=BLUE, label=label)
        if error is None and covariances is None:
            say(ax, "no truth, no covariance")
        symbol, unit = (symbols[0], "m") if k < 3 else (symbols[1], "deg")
        ax.set_ylabel(f"${symbol}_{'xyz'[k % 3]}$ [{unit}]")
    for ax in axes[-1]:
        ax.set_xlabel("time [s]")
    figure.align_ylabels()
    legend(figure)
    return figure


def consistency(record: RunRecord) -> Figure:
    """Pose NEES and NIS of a run over time: see `consistency_over_time`."""
    pose = pose_nees(record)
    value, dof = nis(record)
    no_pose = "no truth" if record.dataset.truth is None else "no pose covariance"
    return consistency_over_time(
        record.filter,
        _times(record),
        no_pose if pose is None else pose,
        (value, dof) if dof.any() else "no innovations",
    )


@styled
def consistency_over_time(
    name: str, times_s: Array, pose: Array | str, nis: tuple[Array, IntArray] | str
) -> Figure:
    """Pose NEES and NIS over time, per degree of freedom, with their two-sided 95 % bands.

    The bands are those of one run at one frame; neighbouring frames are correlated, so the share of
    frames inside is no test.

    Args:
        name: of the filter.
        times_s: shape (T,).
        pose: NEES, 6 degrees of freedom, NaN where there is none, shape (T,); or why there is none.
        nis: with its degrees of freedom, zero of zero where there is none; or why there is none.
    """
    figure = Figure(figsize=(COLUMN_WIDTH_IN, 3.6), layout="constrained")
    top, bottom = figure.subplots(2, 1, sharex=True)
    if isinstance(pose, str):
        say(top, pose)
    else:
        _judge(top, name, times_s, pose, np.full(len(pose), 6))
    if isinstance(nis, str):
        say(bottom, nis)
    else:
        _judge(bottom, name, times_s, *nis)
    top.set_ylabel("pose NEES / 6 [-]")
    bottom.set(xlabel="time [s]", ylabel="NIS / dof [-]")
    figure.align_ylabels()
    legend(figure)
    return figure


def _judge(ax: Axes, name: str, times_s: Array, value: Array, dof: IntArray) -> None:
    """Chi-square values per degree of freedom, with their band and the mean they should have."""
    per_dof = np.where(dof > 0, 1 / np.maximum(dof, 1), np.nan)
    low, high = (bound * per_dof for bound in chi_square_band(np.maximum(dof, 1), PROBABILITY))
    band(ax, times_s, low, high, BAND)
    _expected(ax)
    ax.plot(times_s, value * per_dof, color=BLUE, label=plain(name))
    if infinite := np.count_nonzero(np.isinf(value)):
        say(ax, f"infinite in {infinite} of {len(value)} frames")
    finite = np.isfinite(value * per_dof)
    if finite.any() and np.max((value * per_dof)[finite]) > 3 * np.nanmax(high):
        ax.set_yscale("log")


@styled
def nees(runs: Mapping[str, Sequence[RunRecord]]) -> Figure:
    """The mean over independent runs of the pose's NEES per degree of freedom, a panel a filter.

    The band holds at one instant, for the mean of as many runs.

    Args:
        runs: of each filter, over datasets of the same times with a known truth.
    """
    figure = Figure(figsize=(TEXT_WIDTH_IN, 2.3), layout="constrained")
    axes = figure.subplots(1, len(runs), sharex=True, sharey=True, squeeze=False)[0]
    for ax, (name, records) in zip(axes, runs.items(), strict=True):
        values = [v for record in records if (v := pose_nees(record)) is not None]
        times_s = _times(records[0])
        low, high = chi_square_band(np.full(len(times_s), 6), PROBABILITY, count=len(values))
        band(ax, times_s, low / 6, high / 6, BAND)
        _expected(ax)
        mean = np.mean(values, axis=0) / 6
        ax.plot(times_s, mean, color=BLUE, label=f"mean of {len(values)} runs")
        ax.set(title=plain(name), xlabel="time [s]")
    axes[0].set(ylabel="pose NEES / 6 [-]", ylim=(0, None))
    legend(figure)
    return figure


def _expected(ax: Axes) -> None:
    ax.axhline(1, color="k", linewidth=0.7, linestyle=":", label="expected")


def _times(record: RunRecord) -> Array:
    """Seconds since the first frame."""
    since_start: Array = record.dataset.times_s - record.dataset.times_s[0]
    return since_start
