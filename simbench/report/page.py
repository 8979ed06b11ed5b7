"""What a report is made of, and the HTML that it becomes."""

import base64
import hashlib
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any, Literal, TypeAlias

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from matplotlib.figure import Figure

from simbench import __version__
from simbench.figures import svg
from simbench.figures.drawing import COLUMN_WIDTH_IN
from simbench.report.numbers import number, parts
from vislam.arrays import Array

#: What a text of JSON may hold and a page may not.
_NO_TEXT = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff]")

Tone: TypeAlias = Literal["", "good", "bad", "note"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """One cell of a table.

    Attributes:
        text: what is shown.
        key: what it is sorted by; None stands last whichever way.
        tone: what it says of a filter.
        shade: 0 to 1, how dark it is; None for no shade.
        framed: whether it has a frame.
        number: whether it is set as one, in a column of numbers.
    """

    text: str
    key: float | str | None
    tone: Tone = ""
    shade: float | None = None
    framed: bool = False
    number: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """Rows that sort by each of their columns.

    Attributes:
        title: what it is.
        columns: their names.
        rows: shape (rows, columns).
        numeric: which columns hold numbers, by index.
        folded: whether it is closed at first.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    numeric: frozenset[int] = frozenset()
    folded: bool = False
    kind: str = "table"

    def widths(self) -> list[int | None]:
        """Of each column of numbers the characters from the decimal point on; None of others."""
        return [
            max((len(parts(row[k].text)[1]) for row in self.rows), default=0)
            if k in self.numeric
            else None
            for k in range(len(self.columns))
        ]


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """A figure with what is to be seen in it."""

    figure: Figure
    caption: str
    kind: str = "picture"

    @property
    def wide(self) -> bool:
        """Whether it is too wide for a telephone."""
        return self.figure.get_figwidth() > COLUMN_WIDTH_IN


@dataclass(frozen=True, slots=True, kw_only=True)
class Layer:
    """One thing in a view of the world.

    Attributes:
        name: for the legend.
        shape: a line through the points, or the points alone.
        color: a colour of the page, as `--ink`.
        dashed: of a line.
        points: metres, shape (n, 3).
    """

    name: str
    shape: Literal["line", "dots"]
    color: str
    points: Array
    dashed: bool = False

    def as_json(self) -> dict[str, Any]:
        """In whole millimetres, one number after the other."""
        return {
            "shape": self.shape,
            "color": self.color,
            "dashed": self.dashed,
            "mm": (1000 * self.points).round().astype(int).ravel().tolist(),
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class View:
    """A view of the world that turns."""

    layers: tuple[Layer, ...]
    caption: str
    kind: str = "view"

    def as_json(self) -> list[dict[str, Any]]:
        """For the page's script."""
        return [layer.as_json() for layer in self.layers]


@dataclass(frozen=True, slots=True, kw_only=True)
class Text:
    """Some text as it stands, closed at first."""

    title: str
    text: str
    kind: str = "text"


Block: TypeAlias = Table | Picture | View | Text


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """What failed.

    Attributes:
        names: of the checks.
        found: what was seen, or empty.
        means: what that usually means.
        commands: that show it.
    """

    names: tuple[str, ...]
    found: str
    means: str
    commands: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """What a report says of one thing that was given.

    Attributes:
        kind: what it is, in a word or two.
        title: its name.
        passed: None where nothing was judged.
        verdict: in a sentence or two.
        again: commands that make it again.
        facts: of how it was made, by name.
        findings: what failed.
        blocks: the rest.
    """

    kind: str
    title: str
    passed: bool | None
    verdict: str
    again: tuple[str, ...]
    facts: Mapping[str, str]
    findings: tuple[Finding, ...] = ()
    blocks: tuple[Block, ...] = ()

    @property
    def outcome(self) -> str:
        """The verdict in a word."""
        return "measured" if self.passed is None else "passed" if self.passed else "failed"


def table(
    title: str,
    columns: Sequence[str],
    rows: Iterable[Sequence[Any]],
    *,
    folded: bool = False,
) -> Table:
    """A table of plain values; a column that holds numbers alone is aligned at their points."""
    values = [tuple(row) for row in rows]
    numeric = {
        k
        for k in range(len(columns))
        if any(_is_number(row[k]) for row in values)
        and all(row[k] is None or _is_number(row[k]) for row in values)
    }
    cells = tuple(tuple(map(_cell, row)) for row in values)
    return Table(
        title=title,
        columns=tuple(columns),
        rows=cells,
        numeric=frozenset(numeric),
        folded=folded,
    )


def _cell(value: Any) -> Cell:
    if isinstance(value, Cell):
        return value
    key = value if value is None or _is_number(value) else str(value)
    return Cell(text=number(value), key=key)


def _is_number(value: Any) -> bool:
    if isinstance(value, Cell):
        return value.number
    return isinstance(value, int | float) and not isinstance(value, bool)


def html(sections: Sequence[Section]) -> str:
    """The page: one text that asks nothing of anybody.

    A content security policy forbids every request, and every script but the page's own.
    """
    environment = Environment(
        loader=PackageLoader("simbench.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    prefixes = (f"f{i}-" for i in range(10**9))
    environment.filters["parts"] = parts
    environment.filters["svg"] = lambda figure: Markup(svg(figure, next(prefixes)))
    script = _template("view.js") + _template("page.js")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    page = environment.get_template("report.html.j2").render(
        sections=sections,
        version=__version__,
        style=Markup(_template("report.css")),
        script=Markup(script),
        script_hash=digest,
    )
    return _NO_TEXT.sub("\N{REPLACEMENT CHARACTER}", page)


def _template(name: str) -> str:
    return files("simbench.report").joinpath("templates", name).read_text(encoding="utf-8")
