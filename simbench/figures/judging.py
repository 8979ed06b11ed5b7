"""Pictures of what judges filters."""

from collections.abc import Mapping
from itertools import cycle

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from simbench.bugs import BUGS
from simbench.bugs.matrix import Cell, Matrix, mark
from simbench.errors import InputError
from simbench.figures.drawing import (
    BLUE,
    COLUMN_WIDTH_IN,
    GREY,
    GRID,
    RASTERIZE_ABOVE,
    SHADE,
    TEXT_WIDTH_IN,
    VERMILLION,
    legend,
    plain,
    styled,
)
from vislam.arrays import Array


@styled
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
    ax.grid(which="minor", color=GRID, linewidth=0.5)
    ax.tick_params(which="minor", length=0)
    return figure


def _certainty(cell: Cell) -> float:
    """How reliably a check catches a bug, 0 to 1; the ATE judges nothing."""
    if cell.ratio is not None:
        return 0.0
    return cell.powers[-1].value if cell.powers else float(cell.caught)


@styled
def within_bands(statistics: Mapping[str, tuple[float, float, float]]) -> Figure:
    """Where statistics lie in their bands, each stretched to the same width.

    Args:
        statistics: by name the lower end of the band, the statistic, and the upper end; all finite.
    """
    figure = Figure(figsize=(TEXT_WIDTH_IN, 0.19 * len(statistics) + 0.6), layout="constrained")
    ax = figure.subplots()
    ax.axvspan(0, 1, color=SHADE, linewidth=0)
    for edge in (0, 1):
        ax.axvline(edge, color=GREY, linewidth=0.7, linestyle="--")
    for row, (low, value, high) in enumerate(statistics.values()):
        at = (value - low) / (high - low or 1.0)
        marker = "o" if 0 <= at <= 1 else "x" if -1 <= at <= 2 else "<" if at < -1 else ">"
        color = BLUE if marker == "o" else VERMILLION
        ax.plot(np.clip(at, -1, 2), row, marker, color=color, markersize=4.5, clip_on=False)
    ax.set(xlim=(-1, 2), ylim=(len(statistics) - 0.5, -0.5))
    ax.set_xticks([0, 1], ["low", "high"])
    ax.set_yticks(range(len(statistics)), [plain(name) for name in statistics])
    ax.tick_params(length=0)
    return figure


@styled
def decay(deviations: Mapping[str, Mapping[float, float]]) -> Figure:
    """How deviations fall with the size of the noise: as its square where the code is right.

    Args:
        deviations: by name, by eps; a zero is left out.
    """
    figure = Figure(figsize=(COLUMN_WIDTH_IN, 2.7), layout="constrained")
    ax = figure.subplots()
    for (name, by_eps), marker in zip(deviations.items(), cycle("osD^v"), strict=False):
        points = np.array([(eps, abs(v)) for eps, v in sorted(by_eps.items()) if v])
        if len(points):
            judge = name == next(iter(deviations))
            ax.plot(
                *points.T,
                marker=marker,
                markersize=3.5,
                color=VERMILLION if judge else GREY,
                linewidth=1.2 if judge else 0.7,
                label=plain(name),
            )
    ax.set(xscale="log", yscale="log", xlabel="eps, share of the noise [-]", ylabel="deviation [-]")
    if ax.lines:
        eps = np.array(ax.get_xlim())
        ax.plot(eps, eps**2, "k:", linewidth=0.7, label="eps squared")
        ax.set_xlim(*eps)
    legend(figure)
    return figure


@styled
def spread(values: Mapping[str, Array], label: str, expected: float | None = None) -> Figure:
    """How a number of many runs is spread, a row a filter: box of the quartiles, 5 % to 95 %.

    Args:
        values: of each filter, finite, shape (runs,).
        label: of the axis, with its unit.
        expected: where a right filter's lie.
    """
    figure = Figure(figsize=(COLUMN_WIDTH_IN, 0.34 * len(values) + 0.75), layout="constrained")
    ax = figure.subplots()
    if expected is not None:
        ax.axvline(expected, color="k", linewidth=0.7, linestyle=":")
    for row, runs in enumerate(values.values()):
        offsets = 0.36 * ((np.arange(len(runs)) * 0.618034) % 1 - 0.5)  # side by side, evenly
        ax.plot(
            *(runs, row + offsets),
            linestyle="none",
            marker="o",
            markersize=2,
            markeredgewidth=0,
            color=GREY,
            rasterized=len(runs) > RASTERIZE_ABOVE,
        )
    ax.boxplot(
        list(values.values()),
        positions=range(len(values)),
        orientation="horizontal",
        widths=0.55,
        whis=(5, 95),
        showfliers=False,
        boxprops={"color": BLUE},
        whiskerprops={"color": BLUE},
        capprops={"color": BLUE},
        medianprops={"color": VERMILLION, "linewidth": 1.4},
        manage_ticks=False,
    )
    ax.set_yticks(range(len(values)), [plain(name) for name in values])
    ax.set(ylim=(len(values) - 0.4, -0.6), xlabel=label)
    ax.tick_params(axis="y", length=0)
    ax.margins(x=0.05)
    every = np.concatenate(list(values.values()))
    if every.min() > 0 and every.max() > 30 * every.min():
        ax.set_xscale("log")
    return figure
