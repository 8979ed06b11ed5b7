"""Filters side by side: tables of a summary for a terminal, a README or a paper."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from simbench.campaign.results import read
from simbench.campaign.summary import Summary, summarise
from simbench.errors import InputError

#: What the first table gives the means of: the head of each column.
MEANS = MappingProxyType(
    {
        "ate_rmse_m": "ATE, m",
        "smoothed_ate_rmse_m": "smoothed ATE, m",
        "final_position_error_m": "final, m",
        "final_rotation_error_deg": "final, deg",
        "landmark_rmse_m": "map, m",
        "wall_s": "cost, s",
    }
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """Words in rows.

    Attributes:
        title: a sentence on the whole, without its stop.
        head: of the columns.
        rows: as long as the head.
        notes: what the words mean.
    """

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()


def compare(paths: Sequence[Path | str]) -> Summary:
    """The summary of results.

    Args:
        paths: directories or tables of campaigns, or metrics of `simbench run`.

    Raises:
        DatasetError: one of them is nothing like that.
        InputError: there is no row in them.
    """
    summary = summarise((str(path), read(Path(path))) for path in paths)
    if not summary["groups"]:
        raise InputError(f"{', '.join(map(str, paths))}: expected rows to compare, got none.")
    return summary


def tables(summary: Summary) -> list[Table]:
    """The filters of each case; and where two ran on the same data, their differences."""
    made = [_groups(summary)]
    return [*made, _pairs(summary)] if summary["pairs"] else made


def _groups(summary: Summary) -> Table:
    confidence = f"{100 * summary['confidence']:g} %"
    scenes = _Scenes(summary)
    smoothed = any(group["metrics"]["smoothed_ate_rmse_m"] for group in summary["groups"])
    means = [name for name in MEANS if smoothed or name != "smoothed_ate_rmse_m"]
    heads = (MEANS[name] for name in means)
    head = ("filter", "runs", "lost", "diverged, %", *heads, "NEES", "NIS")
    return Table(
        title=f"{scenes.common}: means over the runs, with intervals at {confidence}",
        head=(*scenes.head, *head),
        rows=tuple((*scenes.cells(group), *_group(group, means)) for group in summary["groups"]),
        notes=(
            "lost: the filter raised, its process died, or it was out of time.",
            f"diverged: {summary['diverged_means']}.",
            "NEES (of the pose at the end) and NIS: over their degrees of freedom, and where they "
            f"lie for a right filter in {confidence} of campaigns; ! marks what lies outside.",
            "cost: the filter's own calls, of one run.",
        ),
    )


def _group(group: Summary, means: Iterable[str]) -> tuple[str, ...]:
    diverged = group["diverged"]
    return (
        group["filter"],
        str(group["runs"]),
        str(group["failed"] + group["hung"]),
        "-" if diverged is None else _between(diverged, "share", 100),
        *(_mean(group["metrics"][name]) for name in means),
        *(_banded(group[name]) for name in ("nees", "nis")),
    )


def _pairs(summary: Summary) -> Table:
    scenes = _Scenes(summary)
    head = ("filter", "against", "error", "runs", "median", "mean", "better, %", "p", "p (Holm)")
    rows = [
        (
            *scenes.cells(pair),
            pair["filter"],
            pair["reference"],
            pair["metric"],
            str(pair["n"]),
            _number(pair["median"]),
            _mean(pair),
            _number(100 * pair["better"]),
            f"{pair['p']:.2g}",
            f"{pair['p_holm']:.2g}",
        )
        for pair in summary["pairs"]
    ]
    return Table(
        title=f"{scenes.common}: differences on the same data",
        head=(*scenes.head, *head),
        rows=tuple(rows),
        notes=(
            "median, mean: of the error less that of the filter it stands against.",
            "better: the share of runs in which the error is the smaller one.",
            f"p: Wilcoxon's signed-rank test, two-sided; Holm's correction is for all {len(rows)}.",
        ),
    )


class _Scenes:
    """What to call the scenes of a summary: what they have in common is said once.

    Attributes:
        common: the scene, and the changes to it, of all rows.
        head: of the columns for what differs.
    """

    def __init__(self, summary: Summary) -> None:
        told = [_told(group) for group in summary["groups"]]
        keys = dict.fromkeys(key for each in told for key in each)
        self.head = tuple(key for key in keys if any(t.get(key) != told[0].get(key) for t in told))
        shared = {key: told[0][key] for key in keys if key not in self.head}
        self.common = " ".join(
            value if key == "scene" else f"{key}={value}" for key, value in shared.items()
        )
        self.common = self.common or f"{len({tuple(t.items()) for t in told})} scenes"

    def cells(self, row: Summary) -> tuple[str, ...]:
        """What differs, of a row."""
        return tuple(_told(row).get(key, "-") for key in self.head)


def _told(row: Summary) -> dict[str, str]:
    return {"scene": row["scenario"]} | {key: str(v) for key, v in row["overrides"].items()}


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"


def _mean(value: Summary | None) -> str:
    """A mean, and half the width of its interval."""
    if value is None:
        return "-"
    half = "" if value["low"] is None else f" ± {(value['high'] - value['low']) / 2:.2g}"
    return _number(value["mean"]) + half


def _between(value: Summary, key: str, scale: float = 1.0) -> str:
    number, low, high = (
        None if value[k] is None else scale * value[k] for k in (key, "low", "high")
    )
    return f"{_number(number)} [{_number(low)}, {_number(high)}]"


def _banded(value: Summary | None) -> str:
    if value is None:
        return "-"
    words = _between(value, "value")
    if value["value"] is None:
        words = words.replace("-", "inf", 1)
    return words if value["inside"] else f"{words} !"


def text(table: Table) -> Iterator[str]:
    """Lines for a terminal."""
    widths = [max(map(len, column)) for column in zip(table.head, *table.rows, strict=True)]
    yield table.title
    for row in (table.head, *table.rows):
        cells = (f"{cell:{width}}" for cell, width in zip(row, widths, strict=True))
        yield "  ".join(cells).rstrip()
    yield from table.notes


def markdown(table: Table) -> Iterator[str]:
    """Lines of GitHub's Markdown."""
    yield f"**{table.title}**"
    yield ""
    for row in (table.head, ("---",) * len(table.head), *table.rows):
        yield "| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |"
    yield ""
    yield from (f"- {note}" for note in table.notes)


def latex(table: Table) -> Iterator[str]:
    """Lines of LaTeX, which need the package booktabs."""
    yield r"\begin{table}"
    yield rf"\caption{{{_escaped(' '.join((f'{table.title}.', *table.notes)))}}}"
    yield rf"\begin{{tabular}}{{{'l' * len(table.head)}}}"
    yield r"\toprule"
    yield _latex_row(table.head)
    yield r"\midrule"
    yield from map(_latex_row, table.rows)
    yield r"\bottomrule"
    yield r"\end{tabular}"
    yield r"\end{table}"


_LATEX = str.maketrans(
    {character: f"\\{character}" for character in "&%$#_{}"}
    | {
        "\\": r"\textbackslash{}",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        "[": "{[}",  # behind \\ a bracket would be its argument
        "±": r"$\pm$",
    }
)


def _escaped(words: str) -> str:
    return words.translate(_LATEX)


def _latex_row(cells: Sequence[str]) -> str:
    return " & ".join(map(_escaped, cells)) + r" \\"


#: The ways to write a table.
FORMATS: Mapping[str, Callable[[Table], Iterator[str]]] = MappingProxyType(
    {"text": text, "markdown": markdown, "latex": latex}
)
