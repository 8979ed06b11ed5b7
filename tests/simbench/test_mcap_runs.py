from dataclasses import replace

import numpy as np
import pytest

from simbench.errors import DatasetError
from simbench.filters import resolve
from simbench.mcap import read_run_mcap, record_to, write_dataset_mcap
from simbench.mcap.runs import map_axes_error
from simbench.metrics import metrics, nees, nis, pose_nees
from simbench.run import run
from simbench.scenario import loads
from simbench.sensors import simulate
from vislam.lie import so3

SCENE = "name: short\nseed: 3\nduration_s: 2.0\nlandmarks: {kind: path, count: 12}\n"


@pytest.fixture(scope="module", params=["slam", "mapping", "dead-reckoning"])
def both(request, tmp_path_factory):
    """A run, and what its recording gives back."""
    path = tmp_path_factory.mktemp("run") / "a.mcap"
    dataset = simulate(loads(SCENE, where="scene"))
    with record_to(path, dataset, request.param) as recorder:
        record = run(dataset, resolve(request.param), name=request.param, on_step=recorder.step)
        recorder.finish(record, metrics(record))
    return record, read_run_mcap(path)


def test_a_recording_gives_back_poses_map_and_metrics(both):
    record, found = both
    assert found.record.filter == record.filter
    np.testing.assert_allclose(found.record.T_world_imu, record.T_world_imu, atol=1e-12)
    np.testing.assert_array_equal(found.record.final.ids, record.final.ids)
    np.testing.assert_allclose(found.record.final.landmarks, record.final.landmarks, atol=1e-5)
    again = metrics(found.record)
    for name in ("ate_rmse_m", "rpe_rot_rmse_deg", "final_position_error_m", "path_length_m"):
        assert found.metrics[name] == pytest.approx(again[name], abs=1e-12)
    assert np.isnan(found.record.wall_s)


def test_a_recording_gives_back_consistency_frame_by_frame(both):
    record, found = both
    value, dof = nis(record)
    np.testing.assert_array_equal(found.nis, value)
    np.testing.assert_array_equal(found.nis_dof, dof)
    expected = pose_nees(record)
    if expected is None:
        assert np.isnan(found.nees).all()
        assert found.record.pose_covariances is None
    else:
        np.testing.assert_array_equal(found.nees, expected)


def test_covariances_are_those_of_errors_along_the_axes_of_the_map(both):
    """Right errors turned into the map by hand: R rho and R phi, to first order."""
    record, found = both
    if record.pose_covariances is None:
        return
    R = record.T_world_imu[:, :3, :3]
    J = np.zeros((len(R), 6, 6))
    J[:, :3, :3] = J[:, 3:, 3:] = R
    expected = J @ record.pose_covariances @ np.swapaxes(J, -1, -2)
    np.testing.assert_allclose(found.record.pose_covariances, expected, atol=1e-12)
    ours, own = found.record.pose_errors, record.pose_errors
    np.testing.assert_allclose(ours, np.einsum("tij,tj->ti", J, own), atol=2e-2 * np.abs(own).max())
    uncertain = found.record.pose_covariances.any(axis=(1, 2))
    near = nees(ours[uncertain], found.record.pose_covariances[uncertain])
    np.testing.assert_allclose(near, found.nees[uncertain], rtol=0.05)


def test_the_error_about_the_map_is_a_difference_and_a_turn():
    rng = np.random.default_rng(5)
    T_hat, T = np.eye(4), np.eye(4)
    T_hat[:3, :3], turn = so3.exp(rng.normal(size=3)), np.array([0.1, -0.2, 0.3])
    T[:3, :3], T[:3, 3] = so3.exp(turn) @ T_hat[:3, :3], [1, 2, 3]
    m_hat, m_true = rng.normal(size=(2, 2, 3))
    error = map_axes_error(T_hat, m_hat, T, m_true)
    np.testing.assert_allclose(error[:6], [1, 2, 3, *turn], atol=1e-12)
    np.testing.assert_allclose(error[6:], (m_true - m_hat).ravel())


def test_a_recording_of_a_dataset_alone_holds_no_run(tmp_path):
    write_dataset_mcap(tmp_path / "a.mcap", simulate(loads(SCENE, where="scene")))
    with pytest.raises(DatasetError, match="simbench run"):
        read_run_mcap(tmp_path / "a.mcap")


def test_smoothed_poses_come_back(tmp_path):
    dataset = simulate(loads(SCENE, where="scene"))
    with record_to(tmp_path / "a.mcap", dataset, "slam") as recorder:
        record = run(dataset, resolve("slam"), name="slam", on_step=recorder.step)
        beliefs = tuple(replace(step.belief) for step in record.steps)
        recorder.finish(replace(record, smoothed=beliefs), metrics(record))
    found = read_run_mcap(tmp_path / "a.mcap").record
    for expected, got in zip(beliefs, found.smoothed, strict=True):
        np.testing.assert_allclose(got.T_world_imu, expected.T_world_imu, atol=1e-12)
