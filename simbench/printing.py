"""What the verbs print: results on standard output, progress on a terminal's standard error."""

import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from simbench.run import Step


@contextmanager
def progress(name: str, frames: int) -> Iterator[Callable[["Step"], None]]:
    """A bar on a terminal's standard error, nothing when piped."""
    if not sys.stderr.isatty():
        yield lambda _: None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(name, total=frames)
        yield lambda step: bar.update(task, completed=step.frame + 1)


@contextmanager
def rows_progress(name: str) -> Iterator[Callable[[int, int], None]]:
    """A bar with rate and time left on a terminal's standard error, nothing when piped."""
    if not sys.stderr.isatty():
        yield lambda _done, _of: None
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(name, total=None, rate="")

        def update(done: int, of: int) -> None:
            speed = bar.tasks[0].speed
            bar.update(
                task, completed=done, total=of, rate="" if speed is None else f"{speed:.3g} rows/s"
            )

        yield update


@contextmanager
def status(text: str) -> Iterator[None]:
    """A line on a terminal's standard error while something runs, nothing when piped."""
    if not sys.stderr.isatty():
        yield
        return
    from rich.console import Console

    with Console(stderr=True).status(text):
        yield


def show(values: Mapping[str, Any], as_json: bool) -> None:
    """Print a result: as JSON, or a line for each value."""
    if as_json:
        print_json(values)
        return
    for line in _lines(values):
        click.echo(line)


def _lines(values: Mapping[str, Any], indent: str = "") -> Iterator[str]:
    width = max(map(len, values), default=0)
    for name, value in values.items():
        head = f"{indent}{name:{width}}"
        if isinstance(value, Mapping):
            yield f"{indent}{name}"
            yield from _lines(value, indent + "  ")
        elif isinstance(value, list):
            yield f"{indent}{name}" if value else f"{head}  -"
            table = bool(value) and all(isinstance(item, Mapping) for item in value)
            for text in _table(value) if table else map(str, value):
                yield f"{indent}  {text}"
        else:
            yield f"{head}  {_text(value)}"


def _table(rows: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """A head and a line for each row, in columns."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    cells = [names, *([_text(row.get(name)) for name in names] for row in rows)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    for line in cells:
        yield "  ".join(f"{c:{w}}" for c, w in zip(line, widths, strict=True)).rstrip()


def _text(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def print_json(value: Any) -> None:
    """Print one JSON value, which holds no NaN."""
    click.echo(json.dumps(value, indent=2, allow_nan=False))
