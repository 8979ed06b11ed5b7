"""The files that a run leaves."""

import json

import pytest

from simbench.filters import resolve
from simbench.outputs import record_run, write_comparison
from simbench.poses import read_poses
from simbench.run import run
from simbench.scenario import loads
from simbench.sensors import simulate


@pytest.fixture(scope="module")
def dataset():
    return simulate(loads("name: small\nduration_s: 2.0\nlandmarks: {kind: box, count: 30}"))


def test_a_run_leaves_a_recording_its_metrics_its_estimate_and_pictures(dataset, tmp_path):
    steps = []
    record, values, paths = record_run(
        dataset, "slam", resolve("slam"), tmp_path, on_step=steps.append
    )
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(path.name for path in paths)
    assert {path.name for path in paths} == {
        f"small.slam{suffix}"
        for suffix in (
            ".mcap",
            ".json",
            ".tum",
            ".trajectory.png",
            ".errors.png",
            ".consistency.png",
        )
    }
    assert json.loads((tmp_path / "small.slam.json").read_text()) == values
    trajectory = read_poses(tmp_path / "small.slam.tum")
    assert trajectory.times_s.tolist() == dataset.times_s.tolist()
    assert trajectory.Ts_world_imu == pytest.approx(record.T_world_imu, abs=1e-12)
    assert [step.frame for step in steps] == list(range(len(dataset)))


def test_a_filters_name_is_made_safe_for_files(dataset, tmp_path):
    _, _, paths = record_run(dataset, "a/b:c d", resolve("dead-reckoning"), tmp_path)
    assert {path.name.split(".")[1] for path in paths} == {"a_b_c_d"}
    assert {path.parent for path in paths} == {tmp_path}


def test_a_comparison_is_one_picture(dataset, tmp_path):
    records = [run(dataset, resolve(name), name=name) for name in ("dead-reckoning", "slam")]
    path = write_comparison(records, tmp_path)
    assert path.name == "small.trajectories.png"
    assert path.read_bytes().startswith(b"\x89PNG")
