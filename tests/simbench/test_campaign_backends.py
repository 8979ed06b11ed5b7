"""Tasks on a cluster give the rows that they give here, also where workers die."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from simbench.campaign import campaign, load
from simbench.campaign.backends import opened
from simbench.errors import InputError
from tests.simbench.campaigns import STUDY, table

SIMBENCH = [sys.executable, "-c", "import sys; from simbench.cli import main; sys.exit(main())"]


@pytest.fixture
def study(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (path := tmp_path / "small.yaml").write_text(STUDY)
    return path


def wait_for(condition, seconds=60.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


@pytest.fixture
def cluster(study):
    """A Dask scheduler and two worker processes on the loopback: the address, and the workers."""
    pytest.importorskip("distributed", reason="needs the extra dask")
    parts = []

    def start(*arguments):
        with study.with_name(f"{len(parts)}.log").open("w") as log:
            command = [sys.executable, "-m", "dask", *arguments]
            parts.append(subprocess.Popen(command, stdout=log, stderr=log))

    start("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard")
    said = study.with_name("0.log")
    wait_for(lambda: "tcp://127.0.0.1:" in said.read_text())
    address = "tcp://127.0.0.1:" + said.read_text().partition("tcp://127.0.0.1:")[2].split()[0]
    for _ in range(2):
        start("worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard")
    yield address, parts[1:]
    for part in reversed(parts):
        part.kill()
        part.wait()


def test_a_dask_cluster_that_loses_a_worker_gives_the_rows_of_this_machine(study, cluster):
    address, (first, _) = cluster
    there = [*SIMBENCH, "campaign", study.name, "--runs", "8", "--out", "there"]
    process = subprocess.Popen(
        [*there, "--backend", "dask", "--scheduler", address],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    journal = Path("there/journal.jsonl")
    wait_for(lambda: journal.exists() and journal.read_bytes().count(b"\n") > 5)
    first.send_signal(signal.SIGKILL)
    first.wait()
    before = journal.read_bytes().count(b"\n")
    said, _ = process.communicate(timeout=120)
    assert process.returncode == 0, said
    assert before < 2 * 8 * 2
    campaign(load(study, (), {"runs": 8}), Path("here"))
    assert table(Path("there")) == table(Path("here"))
    assert {row["status"] for row in table(Path("there"))} == {"done"}


@pytest.mark.slow
def test_ray_gives_the_rows_of_this_machine(study):
    pytest.importorskip("ray", reason="needs the extra ray")
    script = (
        "from pathlib import Path; from simbench.campaign import campaign, load; "
        "campaign(load('small.yaml'), Path('there'), backend='ray')"
    )
    quiet = os.environ | {"RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0", "RAY_USAGE_STATS_ENABLED": "0"}
    subprocess.run([sys.executable, "-c", script], check=True, timeout=300, env=quiet)
    campaign(load(study), Path("here"))
    assert table(Path("there")) == table(Path("here"))


def test_dask_wants_an_address_with_somebody_there():
    pytest.importorskip("distributed", reason="needs the extra dask")
    with (
        pytest.raises(InputError, match="--backend dask: expected --scheduler ADDRESS"),
        opened("dask", None, None),
    ):
        pass


@pytest.mark.parametrize(("backend", "module"), [("dask", "distributed"), ("ray", "ray")])
def test_a_back_end_that_is_not_installed_says_what_to_do(backend, module, monkeypatch):
    monkeypatch.setitem(sys.modules, module, None)
    with (
        pytest.raises(InputError, match=rf"`pip install simbench\[{backend}\]`"),
        opened(backend, "tcp://127.0.0.1:1", None),
    ):
        pass
