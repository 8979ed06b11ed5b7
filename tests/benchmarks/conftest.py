"""What the benchmarks found, printed in the end with the facts of the machine."""

import io
import os
import platform
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TypeAlias

import numpy as np
import pytest
import scipy
from rich import box
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_info

Report: TypeAlias = Callable[[str, Iterable[str], Iterable[Iterable[object]]], None]
TABLES = pytest.StashKey[dict[str, Table]]()


@pytest.fixture
def report(request) -> Report:
    """Adds a table, or rows to one: its title, the heads of its columns, rows.

    Where nothing is timed, nothing is printed.
    """
    tables = request.config.stash.setdefault(TABLES, {})

    def add(title, heads, rows):
        if not request.config.getoption("benchmark_enable"):
            return
        if title not in tables:
            table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD)
            for head in heads:
                table.add_column(head, justify="right")
            tables[title] = table
        for row in rows:
            cells = (f"{v:.3g}" if isinstance(v, float) else str(v) for v in row)
            tables[title].add_row(*cells)

    return add


def machine() -> list[str]:
    """Processor, BLAS and versions, a line each."""
    cpuinfo = Path("/proc/cpuinfo")
    text = cpuinfo.read_text(encoding="utf-8") if cpuinfo.is_file() else ""
    named = re.search(r"model name\s*:\s*(.*)", text)
    load = f", load {os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else ""
    cpu = named[1] if named else platform.processor() or platform.machine()
    blas = sorted(
        {
            f"{pool['internal_api']} {pool['version']} for {pool.get('architecture', 'any')}, "
            f"{pool['num_threads']} threads unless limited"
            for pool in threadpool_info()
            if pool["user_api"] == "blas"
        }
    )
    return [
        f"processor: {cpu}, {os.cpu_count()} cores{load}",
        *(f"BLAS: {line}" for line in blas),
        f"Python {platform.python_version()}, numpy {np.__version__}, scipy {scipy.__version__}",
    ]


def pytest_terminal_summary(terminalreporter, config):
    if tables := config.stash.get(TABLES, {}):
        terminalreporter.section("benchmarks")
        for line in machine():
            terminalreporter.line(line)
        for table in tables.values():
            text = io.StringIO()
            Console(file=text, width=100).print(table)
            terminalreporter.write("\n" + text.getvalue().rstrip() + "\n")
