"""The tables of a campaign: written row by row, and read back so."""

import csv
import json
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from simbench.campaign.rows import COLUMNS, CONSISTENCY, IDENTITY, SERIES, Row
from simbench.errors import DatasetError, InputError
from simbench.files import read_text, replacing

TABLE, PARQUET, SERIES_TABLE = "results.csv", "results.parquet", "series.csv"

_WORDS = ("scenario", "overrides", "case", "filter", "code", "status", "reason")
_WHOLE = ("seed", "run", "diverged", "nis_dof")
#: What tells the row that a line of the series belongs to.
_ROW = ("scenario", "overrides", "case", "filter", "seed", "run")
#: Rows that Parquet holds together.
_ROW_GROUP = 10_000


def written(rows: Iterable[Row], out: Path, outputs: Iterable[str]) -> Iterator[Row]:
    """Write every row that passes through, to all tables.

    Args:
        rows: in the order of the tables.
        out: the directory.
        outputs: of `parquet` and `series`, what is wanted beside the CSV.
    """
    with ExitStack() as files:
        sinks = [files.enter_context(_csv(out / TABLE))]
        if "series" in outputs:
            sinks.append(files.enter_context(_series(out / SERIES_TABLE)))
        if "parquet" in outputs:
            sinks.append(files.enter_context(_parquet(out / PARQUET)))
        for row in rows:
            for sink in sinks:
                sink(row)
            yield row


_Sink = Callable[[Row], Any]


@contextmanager
def _csv(path: Path) -> Iterator[_Sink]:
    with replacing(path) as partial, partial.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(COLUMNS)
        yield lambda row: table.writerow([row.get(column) for column in COLUMNS])


@contextmanager
def _series(path: Path) -> Iterator[_Sink]:
    with replacing(path) as partial, partial.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow((*_ROW, "frame", *SERIES))

        def write(row: Row) -> None:
            head = [row[column] for column in _ROW]
            columns = [row.get("series", {}).get(name, []) for name in SERIES]
            for frame, values in enumerate(zip(*columns, strict=True)):
                table.writerow((*head, frame, *values))

        yield write


@contextmanager
def _parquet(path: Path) -> Iterator[_Sink]:
    arrow, parquet = _arrow()
    types = dict.fromkeys(_WORDS, arrow.string()) | dict.fromkeys(_WHOLE, arrow.int64())
    schema = arrow.schema([(column, types.get(column, arrow.float64())) for column in COLUMNS])
    with replacing(path) as partial, parquet.ParquetWriter(partial, schema) as writer:
        group: list[Row] = []

        def flush() -> None:
            writer.write_table(arrow.Table.from_pylist(group, schema=schema))
            group.clear()

        def write(row: Row) -> None:
            group.append({column: row.get(column) for column in COLUMNS})
            if len(group) == _ROW_GROUP:
                flush()

        yield write
        flush()


def check_outputs(outputs: Iterable[str]) -> None:
    """Refuse what could not be written in the end.

    Raises:
        InputError: Parquet is wanted, and pyarrow is not installed.
    """
    if "parquet" in outputs:
        _arrow()


def _arrow() -> tuple[Any, Any]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise InputError(
            "Parquet: pyarrow is not installed; `pip install simbench[parquet]`."
        ) from error
    return pyarrow, pyarrow.parquet


def read(path: Path) -> Iterator[Row]:
    """The rows of a campaign's directory or table, or of the metrics that `simbench run` wrote.

    Raises:
        DatasetError: it is none of these.
    """
    if path.is_dir():
        path = path / TABLE
    match path.suffix:
        case ".csv":
            yield from _read_csv(path)
        case ".parquet":
            yield from _read_parquet(path)
        case ".json":
            yield from _read_metrics(path)
        case _:
            raise DatasetError(
                f"{path}: expected a campaign's directory, its results (.csv, .parquet), or "
                "metrics of simbench run (.json)."
            )


def _read_csv(path: Path) -> Iterator[Row]:
    try:
        with path.open(encoding="utf-8", newline="") as file:
            table = csv.DictReader(file, strict=True)
            _check_columns(path, table.fieldnames or ())
            for row in table:
                yield _parsed(row, f"{path}:{table.line_num}")
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise DatasetError(f"{path}: cannot be read as results of a campaign: {error}.") from error


def _parsed(row: dict[str, str], where: str) -> Row:
    try:
        return {column: _value(column, text) for column, text in row.items()}
    except (ValueError, TypeError) as error:
        raise DatasetError(f"{where}: expected a row of {len(row)} values: {error}.") from error


def _value(column: str, text: str) -> str | int | float | None:
    if column in _WORDS:
        return text
    if text == "":
        return None
    return int(text) if column in _WHOLE else float(text)


def _read_parquet(path: Path) -> Iterator[Row]:
    arrow, parquet = _arrow()
    try:
        with parquet.ParquetFile(path) as file:
            _check_columns(path, file.schema_arrow.names)
            for rows in file.iter_batches(_ROW_GROUP):
                yield from rows.to_pylist()
    except (OSError, arrow.ArrowException) as error:
        raise DatasetError(f"{path}: cannot be read as results of a campaign: {error}.") from error


def _check_columns(path: Path, columns: Iterable[str]) -> None:
    if missing := {*IDENTITY, *CONSISTENCY} - set(columns):
        raise DatasetError(
            f"{path}: expected the columns of a campaign's results, {min(missing)} is missing."
        )


def _read_metrics(path: Path) -> Iterator[Row]:
    try:
        found = json.loads(read_text(path))
        for values in found if isinstance(found, list) else [found]:
            yield {column: values.get(column) for column in COLUMNS} | {
                "scenario": values["source"],
                "filter": values["filter"],
                "overrides": "{}",
                "case": "",
                "status": "done",
                "reason": "",
            }
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise DatasetError(
            f"{path}: expected metrics as simbench run writes them: {type(error).__name__} {error}."
        ) from error
