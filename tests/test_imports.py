"""Imports go one way, and the command line answers at once."""

import ast
import importlib.util
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

#: A part imports only from those above it; the modules of one package are one part.
LAYERS = [
    "vislam",
    "vislam.arrays",
    "vislam.lie",
    "vislam.camera",
    "vislam.point",
    "vislam.charts",
    "vislam.types",
    "vislam.gaussian",
    "vislam.filters",
    "simbench",
    "simbench.errors",
    "simbench.limits",
    "simbench.files",
    "simbench.rng",
    "simbench.poses",
    "simbench.scenario",
    "simbench.trajectory",
    "simbench.landmarks",
    "simbench.dataset",
    "simbench.sensors",
    "simbench.repeats",
    "simbench.noise",
    "simbench.jumps",
    "simbench.conventions",
    "simbench.npz",
    "simbench.bugs",
    "simbench.filters",
    "simbench.driving",
    "simbench.run",
    "simbench.metrics",
    "simbench.checks",
    "simbench.bugs.power",
    "simbench.bugs.matrix",
    "simbench.mcap",
    "simbench.figures",
    "simbench.source",
    "simbench.info",
    "simbench.convert",
    "simbench.outputs",
    "simbench.campaign",
    "simbench.compare",
    "simbench.report",
    "simbench.gallery",
    "simbench.strategies",
    "simbench.hunt",
    "simbench.pytest_plugin",
    "simbench.printing",
    "simbench.cli",
]

ALLOWED_IN_VISLAM = {"numpy", "scipy", "vislam"} | sys.stdlib_module_names
SLOW_IMPORTS = {"matplotlib", "scipy.stats", "hypothesis", "rosbags"}


def modules(root: Path) -> dict[str, Path]:
    """Every module of both packages, by its dotted name."""
    found = {}
    for package in ("vislam", "simbench"):
        for path in sorted((root / package).rglob("*.py")):
            parts = path.relative_to(root).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imports(name: str, path: Path, known: dict[str, Path]) -> Iterator[str]:
    """The modules that a module names in its import statements, wherever they stand."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            source = node.module or ""
            if node.level:
                package = name if path.name == "__init__.py" else name.rpartition(".")[0]
                source = importlib.util.resolve_name("." * node.level + source, package)
            for alias in node.names:
                inner = f"{source}.{alias.name}"
                yield inner if inner in known else source


def layer(module: str) -> int | None:
    """The place of a module in the list: its own, or that of the package it lies in."""
    places = [
        i
        for i, part in enumerate(LAYERS)
        if module == part or ("." in part and module.startswith(part + "."))
    ]
    return max(places, default=None)


def faults(root: Path) -> list[str]:
    """What stands against the order, a line each."""
    known, found = modules(root), []
    for name, path in known.items():
        own = layer(name)
        if own is None:
            found.append(
                f"{name} is in no layer: give it a place in LAYERS of tests/test_imports.py"
            )
            continue
        for source in imports(name, path, known):
            package = source.partition(".")[0]
            if name.startswith("vislam") and package not in ALLOWED_IN_VISLAM:
                found.append(f"{name} imports {source}; vislam may import numpy and scipy only")
            elif package in ("vislam", "simbench"):
                other = layer(source)
                if other is None:
                    found.append(f"{name} imports {source}, which is in no layer")
                elif other > own:
                    found.append(f"{name} imports {source}, which stands below it in LAYERS")
    return found


def test_every_module_imports_only_from_parts_above_it():
    assert len(modules(ROOT)) > 10
    assert not faults(ROOT), "\n".join(faults(ROOT))


@pytest.mark.parametrize(
    ("module", "line", "fault"),
    [
        ("vislam/lie/so3.py", "from vislam import camera", "vislam.camera, which stands below"),
        ("vislam/lie/so3.py", "from ..camera import project", "vislam.camera, which stands below"),
        ("vislam/lie/__init__.py", "from .. import types", "vislam.types, which stands below"),
        ("vislam/camera.py", "import simbench.rng", "imports simbench.rng; vislam may import"),
        ("vislam/camera.py", "import matplotlib.pyplot", "imports matplotlib.pyplot; vislam may"),
        (
            "simbench/rng.py",
            "def f():\n    import simbench.cli",
            "simbench.cli, which stands below",
        ),
        ("simbench/rng.py", "import simbench.nowhere", "simbench.nowhere, which is in no layer"),
        ("simbench/utils.py", "", "simbench.utils is in no layer: give it a place"),
        ("vislam/lie_extra.py", "", "vislam.lie_extra is in no layer"),
        ("simbench/cli.py", "import vislam.lie.so3, rich\nfrom simbench import run", None),
        ("vislam/filters/slam.py", "import math, scipy.linalg\nfrom vislam.filters import x", None),
    ],
)
def test_order_of_imports_is_really_held(tmp_path, module, line, fault):
    for name in (
        "vislam/camera.py",
        "vislam/types/__init__.py",
        "simbench/cli.py",
        "simbench/run.py",
        module,
    ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    (tmp_path / module).write_text(line)
    if fault is None:
        assert faults(tmp_path) == []
    else:
        (message,) = faults(tmp_path)
        assert fault in message


ANSWERS = [
    ["--help"],
    *(
        ["list", what]
        for what in ("filters", "checks", "trajectories", "landmarks", "bugs", "schema")
    ),
]


def answer(arguments: list[str]) -> list[str]:
    """Run the console script; its CPU seconds, then the modules it loaded."""
    script = (
        "import atexit, os, sys\n"
        "def report():\n"
        "    print(sum(os.times()[:2]), *sys.modules, file=sys.stderr)\n"
        "atexit.register(report)\n"
        f"sys.argv = ['simbench', *{arguments!r}]\n"
        "from simbench.cli import main\n"
        "sys.exit(main())\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()
    return done.stderr.splitlines()[-1].split()


@pytest.mark.parametrize("arguments", ANSWERS, ids=" ".join)
def test_answer_loads_nothing_slow(arguments):
    _, *loaded = answer(arguments)
    assert "simbench.cli" in loaded
    assert not SLOW_IMPORTS & set(loaded)


@pytest.mark.parametrize("arguments", ANSWERS, ids=" ".join)
def test_answer_takes_less_than_300_ms_of_cpu(arguments):
    assert min(float(answer(arguments)[0]) for _ in range(3)) < 0.3
