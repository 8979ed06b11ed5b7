"""Whatever a stranger's file claims: one message, in bounded memory and time."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from simbench.cli import main
from simbench.cli.options import WRONG_INPUT
from simbench.mcap import write_dataset_mcap
from tests.simbench.bombs import BOMBS, scene
from tests.simbench.recordings import drive

ROOT = Path(__file__).parents[2]
ADDRESS_SPACE = 3 * 2**30
SECONDS = 20
SCRIPT = f"""
import resource, sys, time
from pathlib import Path
resource.setrlimit(resource.RLIMIT_AS, ({ADDRESS_SPACE}, {ADDRESS_SPACE}))
resource.setrlimit(resource.RLIMIT_FSIZE, (2**26, 2**26))
from simbench.cli import main
for path in sorted(Path("bombs").iterdir()):
    print("\\0", path.stem, file=sys.stderr)
    start = time.process_time()
    status = main(["info", str(path)])
    print("\\0", status, time.process_time() - start, file=sys.stderr)
"""


@pytest.fixture(scope="module")
def answers(tmp_path_factory):
    """Exit status, CPU seconds and message of `simbench info` for each bomb."""
    directory = tmp_path_factory.mktemp("here")
    (directory / "bombs").mkdir()
    for name, write in BOMBS.items():
        path = directory / "bombs" / name
        path.rename(path.with_name(name + write(path)))
    before = sorted(path.name for path in (directory / "bombs").iterdir())
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        cwd=directory,
        env=os.environ | {"PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert sorted(path.name for path in (directory / "bombs").iterdir()) == before
    assert [path.name for path in directory.iterdir()] == ["bombs"]
    parts = done.stderr.split("\0")[1:]
    found = {}
    for head, tail in zip(parts[::2], parts[1::2], strict=True):
        name, _, message = head.strip().partition("\n")
        status, seconds = tail.split()
        found[name] = int(status), float(seconds), message
    return found


@pytest.mark.parametrize("name", BOMBS)
def test_a_bomb_is_one_message_in_bounded_memory_and_time(answers, name):
    status, seconds, message = answers[name]
    assert status == WRONG_INPUT, message
    assert "Traceback" not in message
    assert "Warning" not in message
    assert 0 < len(message) < 20_000
    assert seconds < SECONDS


def test_limit_is_named_by_the_message_and_raised_by_the_option(tmp_path, capsys):
    path = tmp_path / "long.yaml"
    scene("duration_s: 2\nimu: {raw: {rate_hz: 5000}}\n")(path)
    assert main(["info", str(path), "--limit", "5MB"]) == WRONG_INPUT
    said = capsys.readouterr().err
    assert "a raw IMU of 1e+04 samples takes 9.766 MB, above the limit of 5 MB" in said
    assert "--limit SIZE" in said
    assert main(["info", str(path), "--limit", "10 MB"]) == 0
    assert main(["info", str(path), "--limit", "ten"]) == WRONG_INPUT
    assert "Expected a size such as 500MB or 8GB, got 'ten'" in capsys.readouterr().err
    assert main(["info", str(path)]) == 0


def test_a_pipe_or_a_device_is_refused_at_once(tmp_path, capsys):
    os.mkfifo(tmp_path / "pipe.mcap")
    for path in (tmp_path / "pipe.mcap", Path("/dev/zero")):
        assert main(["info", str(path)]) == WRONG_INPUT
        assert "it is a device or a pipe" in capsys.readouterr().err


def test_a_name_in_a_recording_that_climbs_stays_in_the_directory(tmp_path):
    out = tmp_path / "a" / "b" / "out"
    recording = tmp_path / "r.mcap"
    write_dataset_mcap(recording, replace(drive(), name="../../climbed"))
    assert main(["run", str(recording), "--filter", "dead-reckoning", "--out", str(out)]) == 0
    assert {path.parent for path in tmp_path.rglob("*.*")} == {tmp_path, out}
    assert (out / ".._.._climbed.dead-reckoning.tum").is_file()
