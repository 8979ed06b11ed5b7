"""The linters that the project is held to; their rules stand in pyproject.toml."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize("linter", ["ruff check", "ruff format --check", "mypy"])
def test_a_linter_has_nothing_to_say(linter):
    said = subprocess.run(
        [sys.executable, "-m", *linter.split()], cwd=ROOT, capture_output=True, text=True
    )
    assert said.returncode == 0, said.stdout
