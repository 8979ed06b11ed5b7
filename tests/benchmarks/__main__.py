"""Runs all benchmarks, those that take minutes too: python -m tests.benchmarks [options of pytest].

With `-k NAME` only some of them, with `-m "not slow"` the short ones.
"""

import sys
from pathlib import Path

import pytest

TABLES_ONLY = ["-q", "--no-header", "--benchmark-columns=median,iqr,rounds"]

if __name__ == "__main__":
    here = str(Path(__file__).parent)
    sys.exit(pytest.main([here, "-m", "", "--benchmark-enable", *TABLES_ONLY, *sys.argv[1:]]))
