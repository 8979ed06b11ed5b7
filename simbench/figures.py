"""Pictures of runs, for people and for papers.

Each function returns a matplotlib `Figure` that no global state knows of: show it in a notebook, or
`save` it. Line styles and markers carry the meaning as well as the colours (Okabe and Ito's, which
the colour-blind can tell apart), so that a grey print can be read.
"""

from collections.abc import Callable, Sequence
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec

import matplotlib.style
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from simbench.bugs import BUGS
from simbench.bugs.matrix import Cell, Matrix, mark
from simbench.errors import InputError, OutputError
from simbench.files import replacing
from simbench.metrics import ate, chi_square_band, nis, pose_nees, rmse
from simbench.run import RunRecord
from vislam.arrays import Array, IntArray

P = ParamSpec("P")

TEXT_WIDTH_IN, COLUMN_WIDTH_IN = 7.16, 3.5  # of a two-column paper
RASTERIZE_ABOVE = 500  # markers: a vector file with more is slow to open
PROBABILITY = 0.95  # of the bands of NEES and NIS

BLUE, VERMILLION, GREY, SHADE = "#0072B2", "#D55E00", "#767676", "#D9D9D9"

_STYLE: Any = [
    "default",  # whatever the user's own matplotlibrc says, equal inputs give equal pictures
    {
        "font.size": 8,
        "axes.titlesize": 8,
        "legend.fontsize": 7.5,
        "xtick.labelsize": 7,
        "ytick.labelsize": 7,
        "axes.linewidth": 0.6,
        "axes.grid": True,
        "axes.axisbelow": True,
        "axes.xmargin": 0,
        "grid.color": "#E8E8E8",
        "grid.linewidth": 0.5,
        "lines.linewidth": 0.9,
        "legend.frameon": False,
        "pdf.fonttype": 42,
        "svg.hashsalt": "simbench",
    },
]

#: File formats, and the metadata that would differ between equal pictures.
_UNDATED: dict[str, dict[str, None]] = {
    "png": {"Software": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
    "svg": {"Date": None, "Creator": None},
}


def _styled(draw: Callable[P, Figure]) -> Callable[P, Figure]:
    @wraps(draw)
    def styled(*args: P.args, **kwargs: P.kwargs) -> Figure:
        with matplotlib.style.context(_STYLE):
            return draw(*args, **kwargs)

    return styled


def save(figure: Figure, path: Path) -> None:
    """Write a figure as .png (200 dpi), .pdf or .svg; equal figures give equal bytes.

    Raises:
        OutputError: another suffix, or the file cannot be written.
    """
    kind = path.suffix.removeprefix(".").lower()
    if kind not in _UNDATED:
        raise OutputError(f"Cannot write {path}: expected a name that ends in .png, .pdf or .svg.")
    with replacing(path) as partial, matplotlib.style.context(_STYLE):
        figure.savefig(partial, format=kind, dpi=200, metadata=_UNDATED[kind])


@_styled
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
    size = width, rows * (shape * panel + 0.55) + 0.4
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
    _legend(figure)
    return figure


def _draw_map(ax: Axes, record: RunRecord) -> None:
    """One panel of `trajectories`."""
    truth, path = record.dataset.truth, record.T_world_imu[:, :2, 3]
    title = record.filter
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


@_styled
def errors(record: RunRecord) -> Figure:
    """The error of the pose with its 3-sigma bands over time, in the filter's own chart, by axis.

    Without truth the bands alone are drawn, without a covariance the error alone: the legend says
    so.
    """
    times_s, error, covariances = _times(record), record.pose_errors, record.pose_covariances
    in_units = np.repeat([1.0, 180 / np.pi], 3)
    figure = Figure(figsize=(TEXT_WIDTH_IN, 4.2), layout="constrained")
    axes = figure.subplots(3, 2, sharex=True)
    for k, ax in enumerate(axes.T.flat):
        if covariances is not None:
            bound = 3 * in_units[k] * np.sqrt(np.maximum(covariances[:, k, k], 0))
            _band(ax, times_s, -bound, bound, r"$\pm 3\sigma$" + ", no truth" * (error is None))
        if error is not None:
            label = "error" + ", no covariance" * (covariances is None)
            ax.plot(times_s, in_units[k] * error[:, k], color=BLUE, label=label)
        if error is None and covariances is None:
            _say(ax, "no truth, no covariance")
        symbol, unit = (r"\rho", "m") if k < 3 else (r"\phi", "deg")
        ax.set_ylabel(f"${symbol}_{'xyz'[k % 3]}$ [{unit}]")
    for ax in axes[-1]:
        ax.set_xlabel("time [s]")
    figure.align_ylabels()
    _legend(figure)
    return figure


@_styled
def consistency(record: RunRecord) -> Figure:
    """Pose NEES and NIS over time, per degree of freedom, with their two-sided 95 % bands.

    The bands are those of one run at one frame; neighbouring frames are correlated, so the share of
    frames inside is no test. A panel without values says why.
    """
    pose = pose_nees(record)
    figure = Figure(figsize=(COLUMN_WIDTH_IN, 3.6), layout="constrained")
    top, bottom = figure.subplots(2, 1, sharex=True)
    if pose is None:
        _say(top, "no truth" if record.dataset.truth is None else "no pose covariance")
    else:
        _judge(top, record, pose, np.full(len(pose), 6))
    value, dof = nis(record)
    if dof.any():
        _judge(bottom, record, value, dof)
    else:
        _say(bottom, "no innovations")
    top.set_ylabel("pose NEES / 6 [-]")
    bottom.set(xlabel="time [s]", ylabel="NIS / dof [-]")
    figure.align_ylabels()
    _legend(figure)
    return figure


def _judge(ax: Axes, record: RunRecord, value: Array, dof: IntArray) -> None:
    """Chi-square values per degree of freedom, with their band and the mean they should have."""
    times_s, per_dof = _times(record), np.where(dof > 0, 1 / np.maximum(dof, 1), np.nan)
    low, high = (bound * per_dof for bound in chi_square_band(np.maximum(dof, 1), PROBABILITY))
    _band(ax, times_s, low, high, f"{100 * PROBABILITY:.0f} % band")
    ax.axhline(1, color="k", linewidth=0.7, linestyle=":", label="expected")
    ax.plot(times_s, value * per_dof, color=BLUE, label=record.filter)
    if infinite := np.count_nonzero(np.isinf(value)):
        _say(ax, f"infinite in {infinite} of {len(value)} frames")
    finite = np.isfinite(value * per_dof)
    if finite.any() and np.max((value * per_dof)[finite]) > 3 * np.nanmax(high):
        ax.set_yscale("log")


def _band(ax: Axes, times_s: Array, low: Array, high: Array, label: str) -> None:
    """A shaded band with dashed edges, so that it is seen beneath what crosses it."""
    ax.fill_between(times_s, low, high, color=SHADE, linewidth=0, label=label)
    for edge in (low, high):
        ax.plot(times_s, edge, color=GREY, linewidth=0.7, linestyle="--")


def _say(ax: Axes, reason: str) -> None:
    """In place of values that are not there."""
    if not ax.lines:
        ax.set_yticks([])
    box = {"facecolor": "w", "edgecolor": "none", "pad": 1}
    ax.text(0.5, 0.5, reason, transform=ax.transAxes, ha="center", va="center", bbox=box)


def _legend(figure: Figure) -> None:
    """One legend above all panels, each label once."""
    entries: dict[str, Any] = {}
    for ax in figure.axes:
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    if not entries:
        return
    rows = 1 if figure.get_figwidth() > COLUMN_WIDTH_IN else -(-len(entries) // 3)
    legend = figure.legend(
        list(entries.values()),
        list(entries),
        loc="outside upper center",
        ncols=-(-len(entries) // rows),
    )
    for line in legend.get_lines():
        line.set_markersize(max(line.get_markersize(), 3.5))


@_styled
def bugs(found: Matrix) -> Figure:
    """Which check catches which bug: the darker, the more reliably; framed where it must.

    A tick is a check of which one run tells. A number is the power at 20 runs, where that is more
    than false alarms, and in the last column how many times its base's ATE a bug has.
    """
    if not found:
        raise InputError("Expected at least one bug to draw, got none.")
    rows, columns = list(found), list(next(iter(found.values())))
    shade = np.array([[_certainty(found[row][c]) for c in columns] for row in rows])
    figure = Figure(figsize=(TEXT_WIDTH_IN, 0.17 * len(rows) + 1.1), layout="constrained")
    ax = figure.subplots()
    ax.imshow(shade, cmap="Greys", vmin=0, vmax=1.25, aspect="auto")
    for (y, x), dark in np.ndenumerate(shade):
        sign, color = mark(found[rows[y]][columns[x]]), "w" if dark > 0.6 else "k"
        text = {".": "", "x": "\N{CHECK MARK}"}.get(sign, sign)
        ax.text(x, y, text, ha="center", va="center", color=color, fontsize=6.5)
        if columns[x] in BUGS[rows[y]].checks:
            frame = Rectangle((x - 0.46, y - 0.42), 0.92, 0.84, fill=False, linewidth=1.0)
            frame.set_edgecolor(VERMILLION)
            ax.add_patch(frame)
    ax.set_xticks(range(len(columns)), [*columns[:-1], columns[-1].replace("ate", "ATE ratio")])
    ax.tick_params(axis="x", rotation=40, top=True, labeltop=True, bottom=False, labelbottom=False)
    for label in ax.get_xticklabels():
        label.set(ha="left", rotation_mode="anchor")
    ax.set_yticks(range(len(rows)), rows)
    ax.tick_params(length=0)
    ax.grid(visible=False)
    ax.set_xticks(np.arange(0.5, len(columns) - 1), minor=True)
    ax.set_yticks(np.arange(0.5, len(rows) - 1), minor=True)
    ax.grid(which="minor", color="#E8E8E8", linewidth=0.5)
    ax.tick_params(which="minor", length=0)
    return figure


def _certainty(cell: Cell) -> float:
    """How reliably a check catches a bug, 0 to 1; the ATE judges nothing."""
    if cell.ratio is not None:
        return 0.0
    return cell.powers[-1].value if cell.powers else float(cell.caught)


def _times(record: RunRecord) -> Array:
    """Seconds since the first frame."""
    since_start: Array = record.dataset.times_s - record.dataset.times_s[0]
    return since_start
