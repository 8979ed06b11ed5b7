"""How pictures look, what they share, and how they are written."""

import re
import warnings
from collections.abc import Callable
from functools import wraps
from io import StringIO
from pathlib import Path
from typing import Any, ParamSpec

import matplotlib.style
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from simbench.errors import OutputError
from simbench.files import replacing
from vislam.arrays import Array

P = ParamSpec("P")

TEXT_WIDTH_IN, COLUMN_WIDTH_IN = 7.16, 3.5  # of a two-column paper
RASTERIZE_ABOVE = 500  # markers: a vector file with more is slow to open
LONGEST = 40  # characters of a name
PROBABILITY = 0.95  # of the bands of NEES and NIS

BLUE, VERMILLION = "#0072B2", "#D55E00"
GREY, SHADE, GRID = "#767676", "#D9D9D9", "#E8E8E8"

STYLE: Any = [
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
        "grid.color": GRID,
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

_METADATA = ("Date", "Creator", "Format", "Type")

#: What a page calls the colours of a picture.
_PAGE_COLORS = {
    BLUE.lower(): "--blue",
    VERMILLION.lower(): "--vermillion",
    GREY.lower(): "--grey",
    SHADE.lower(): "--shade",
    GRID.lower(): "--grid",
    "#000000": "--ink",
    "#ffffff": "--paper",
}


def plain(name: str) -> str:
    """A user's name as text of a picture: one short line, no mathematics in it."""
    printable = "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in name)
    short = printable if len(printable) <= LONGEST else f"{printable[: LONGEST - 1]}…"
    return short.replace("$", r"\$")


def styled(draw: Callable[P, Figure]) -> Callable[P, Figure]:
    """Draw in the style of all pictures, whatever the user's own is."""

    @wraps(draw)
    def drawn(*args: P.args, **kwargs: P.kwargs) -> Figure:
        with matplotlib.style.context(STYLE):
            return draw(*args, **kwargs)

    return drawn


def save(figure: Figure, path: Path) -> None:
    """Write a figure as .png (200 dpi), .pdf or .svg; equal figures give equal bytes.

    Raises:
        OutputError: another suffix, or the file cannot be written.
    """
    kind = path.suffix.removeprefix(".").lower()
    if kind not in _UNDATED:
        raise OutputError(f"Cannot write {path}: expected a name that ends in .png, .pdf or .svg.")
    with replacing(path) as partial, matplotlib.style.context(STYLE):
        figure.savefig(partial, format=kind, dpi=200, metadata=_UNDATED[kind])


def svg(figure: Figure, prefix: str) -> str:
    """A figure as an element of an HTML page that gives its colours and fonts.

    Colours are the page's `--ink`, `--paper`, `--grey`, `--shade`, `--grid`, `--blue` and
    `--vermillion`, so that one figure serves a light page and a dark one.

    Args:
        figure: the figure.
        prefix: of all ids, one of its own for each figure of the page.
    """
    text = StringIO()
    with matplotlib.style.context([*STYLE, {"svg.fonttype": "none"}]), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from font")  # the page has another font
        figure.savefig(text, format="svg", transparent=True, metadata=dict.fromkeys(_METADATA))
    found = text.getvalue()
    found = found[found.index("<svg") :]
    found = re.sub(r"<metadata>.*?</metadata>\s*", "", found, flags=re.DOTALL)
    found = re.sub(r' xmlns(:\w+)?="[^"]*"| version="1.1"', "", found)  # HTML knows what an svg is
    found = re.sub(r'(?<= id=")|(?<=url\(#)|(?<=xlink:href="#)', prefix, found)
    colors = re.compile("|".join(_PAGE_COLORS), re.IGNORECASE)
    return colors.sub(lambda match: f"var({_PAGE_COLORS[match[0].lower()]})", found)


def band(ax: Axes, times_s: Array, low: Array, high: Array, label: str) -> None:
    """A shaded band with dashed edges, so that it is seen beneath what crosses it."""
    ax.fill_between(times_s, low, high, color=SHADE, linewidth=0, label=label)
    for edge in (low, high):
        ax.plot(times_s, edge, color=GREY, linewidth=0.7, linestyle="--")


def say(ax: Axes, reason: str) -> None:
    """In place of values that are not there."""
    if not ax.lines:
        ax.set_yticks([])
    box = {"facecolor": "w", "edgecolor": "none", "pad": 1}
    ax.text(0.5, 0.5, reason, transform=ax.transAxes, ha="center", va="center", bbox=box)


def legend(figure: Figure) -> None:
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
