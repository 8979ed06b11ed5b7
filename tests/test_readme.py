"""What the README shows is what happens."""

import ast
import inspect
import os
import re
import subprocess
import sys
import typing
from pathlib import Path

import pytest

import vislam.types
from vislam.filters.protocol import Filter

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
INSTALLED = Path(sys.executable).parent


def blocks(language):
    return re.findall(rf"^```{language}\n(.*?)^```", README, re.MULTILINE | re.DOTALL)


def is_sketch(block):
    """A block that only shows what something looks like: a class whose bodies are all `...`."""
    body = ast.parse(block).body
    return len(body) == 1 and isinstance(body[0], ast.ClassDef)


def commands():
    """What the bash and console blocks run, in order, without making an environment."""
    lines = []
    for block in re.findall(r"^```(?:bash|console)\n(.*?)^```", README, re.MULTILINE | re.DOTALL):
        prompted = [line[2:] for line in block.splitlines() if line.startswith("$ ")]
        lines += prompted or block.splitlines()
    each = [part.strip() for line in lines for part in line.split(" && ")]
    return [c for c in each if not re.search(r"-m venv|pip install|-m pytest", c)]


@pytest.fixture(scope="module")
def clone(tmp_path_factory):
    """A directory that looks like a clone, in which commands leave files for the next."""
    path = tmp_path_factory.mktemp("clone")
    for name in ("scenarios", "tests"):
        (path / name).symlink_to(ROOT / name)
    return path


@pytest.fixture
def within(clone, monkeypatch):
    monkeypatch.chdir(clone)


def shell(command, where):
    return subprocess.run(
        ["bash", "-c", command.replace(".venv/bin/", "")],
        cwd=where,
        capture_output=True,
        text=True,
        timeout=300,
        env=os.environ | {"PATH": f"{INSTALLED}:{os.environ['PATH']}", "MPLBACKEND": "agg"},
    )


@pytest.mark.usefixtures("within")
@pytest.mark.parametrize("block", [b for b in blocks("python") if not is_sketch(b)])
def test_a_python_block_runs_as_it_stands(block, capsys):
    exec(compile(block, "README.md", "exec"), {"__name__": "readme"})
    assert "print(" not in block or capsys.readouterr().out


def test_the_first_block_prints_an_error_of_some_centimetres(clone):
    said = subprocess.run(
        [sys.executable, "-c", blocks("python")[0]],
        cwd=clone,
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    assert 0.01 < float(said.stdout.split()[-1]) < 0.15


def test_the_filter_that_is_shown_is_the_protocol():
    names = vars(vislam.types) | vars(typing)
    for block in filter(is_sketch, blocks("python")):
        exec(compile(block, "README.md", "exec"), scope := dict(names))
        for name in ("predict", "update", "belief"):
            shown, true = getattr(scope["Filter"], name), getattr(Filter, name)
            assert inspect.signature(shown) == inspect.signature(true)


def test_the_commands_run_as_they_stand_one_after_the_other(clone):
    for command in commands():
        said = shell(command, clone)
        judged = "broken_filter:" in command or "+" in command
        assert said.returncode == (1 if judged else 0), (command, said.stderr)
        assert "Traceback" not in said.stderr
    assert list((clone / "out").glob("hunt-*.yaml"))


@pytest.mark.parametrize("block", blocks("console"))
def test_every_line_that_a_console_block_shows_is_printed(block, clone):
    for command, shown in re.findall(r"^\$ (.*)\n((?:(?!\$ ).*\n)*)", block, re.MULTILINE):
        if shown:
            printed = shell(command, clone).stdout.splitlines()
            assert [line for line in shown.splitlines() if line not in printed] == []


def test_links_and_pictures_are_there():
    for target in re.findall(r"\]\(([^)]+)\)", README):
        if target.startswith("#"):
            headings = re.findall(r"^#+ (.*)$", README, re.MULTILINE)
            assert target[1:] in [heading.lower().replace(" ", "-") for heading in headings]
        elif "://" not in target:
            assert (ROOT / target).exists(), target


def test_every_verb_and_every_scene_is_in_its_table():
    from simbench.cli import cli

    for verb in cli.commands:
        assert f"`simbench {verb}" in README, verb
    for path in (ROOT / "scenarios").glob("*.yaml"):
        assert f"`{path.stem}`" in README, path.stem


def test_the_marked_commands_are_one_line_each():
    for mark in ("run", "test"):
        marked = re.search(rf"<!-- {mark} -->\n```bash\n(.*?)```\n<!-- end -->", README, re.DOTALL)
        assert marked is not None
        assert len(marked[1].splitlines()) == 1
