"""The sensor of relative positions, from the scene to the filter and into the recording."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from simbench.checks.audit import audit_drive
from simbench.checks.conformance import CHECKS
from simbench.checks.conformance import resolve as check_of
from simbench.checks.short_drive import ShortDrive
from simbench.errors import DatasetError, ScenarioError
from simbench.filters import resolve
from simbench.info import info
from simbench.mcap import read_dataset_mcap
from simbench.metrics import metrics
from simbench.npz import write_npz
from simbench.outputs import record_run, write_dataset
from simbench.run import run
from simbench.scenario import load, loads
from simbench.sensors import simulate
from vislam.types import Noise, PointFrame

ZHANG = Path(__file__).parents[2] / "scenarios" / "zhang.yaml"
SCENE = """
seed: 4
duration_s: 2.0
rate_hz: 4.0
time_jitter: 0.5
trajectory: {kind: straight, roll_deg: 10.0, pitch_deg: 8.0, roll_period_s: 2.0}
landmarks: {kind: box, count: 6, size_m: [14.0, 14.0, 6.0]}
rig: {imu_cam: {translation_m: [1.1, -0.3, 0.7], rotvec_deg: [4.0, -6.0, 3.0]}}
point: {range_m: [0.2, 9.0], view_deg: 200.0, share: 0.02, floor_m: 0.03}
camera: {dropout: 0.2}
imu:
  velocity: {share: 0.1, sigma: 0.05}
  angular_velocity: {share: 0.1, sigma: 0.01}
filter: {process_noise: twist-relative, gate: 0.999}
"""


def short():
    return ShortDrive.of(simulate(loads(SCENE)), 200)


def test_a_reading_is_the_landmark_in_the_sensors_frame_with_noise_that_is_a_share_of_it():
    scene = loads(SCENE, overrides=["landmarks.count=40"])
    z = []
    for k in range(60):
        dataset = simulate(scene, run=k)
        truth = dataset.truth
        for i in range(len(dataset)):
            frame = dataset.frame(i)
            T_world_sensor = truth.T_world_imu[i] @ truth.calibration.T_imu_cam
            homogeneous = np.column_stack([truth.landmarks[frame.ids], np.ones(len(frame.ids))])
            q = (np.linalg.inv(T_world_sensor) @ homogeneous.T).T[:, :3]
            distance = np.linalg.norm(q, axis=1)
            assert ((distance >= 0.2) & (distance <= 9.0)).all()
            assert (np.rad2deg(np.arccos(q[:, 2] / distance)) <= 100).all()
            z.append((frame.points - q) / np.maximum(0.02 * np.abs(q), 0.03))
    z = np.concatenate(z)
    # N = 3 len(z), two-sided 5 sigma: false alarm 6e-7 each
    assert len(z) > 3000
    assert abs(z.mean()) < 5 / np.sqrt(z.size)
    assert abs(np.square(z).mean() - 1) < 5 * np.sqrt(2 / z.size)


def test_twist_noise_is_a_share_of_the_true_twist_and_no_less_than_sigma():
    n = []
    scene = loads(SCENE, overrides=["duration_s=600.0", "landmarks.count=1"])
    for k in range(2):
        dataset = simulate(scene, run=k)
        truth = np.hstack([dataset.truth.linear_velocity, dataset.truth.angular_velocity])
        read = dataset.twists
        floor = np.repeat([0.05, 0.01], 3)
        n.append((read - truth) / np.maximum(0.1 * np.abs(truth), floor))
    n = np.concatenate(n)  # N = 2 * 2401 of each component; 5 sigma
    assert (np.abs(np.square(n).mean(axis=0) - 1) < 5 * np.sqrt(2 / len(n))).all()


def test_a_told_twist_covariance_is_the_larger_of_share_and_floor():
    noise = Noise(
        process_model="twist-relative",
        process=np.diag(np.square([0.1, 0.1, 0.1, 0.01, 0.01, 0.01])),
        twist_share=np.full(6, 0.05),
        sigma_px=np.ones(4),
    )
    u = np.array([[4.0, -1.0, 0.0, 0.0, 1.0, -0.1], np.zeros(6)])
    found = noise.twist_covariance(u)
    assert np.allclose(np.sqrt(np.diagonal(found[0])), [0.2, 0.1, 0.1, 0.01, 0.05, 0.01])
    assert np.array_equal(found[1], noise.process)
    assert np.count_nonzero(found[0] - np.diag(np.diag(found[0]))) == 0


@pytest.mark.parametrize("name", ["slam", "slam-transport", "slam-fej", "slam-invariant"])
def test_the_exact_audit_passes_with_points(name):
    result = audit_drive(resolve(name), short())
    assert result.first is None, result.first
    assert result.scalars > 100
    assert audit_drive(resolve(name), ShortDrive.of(simulate(load(ZHANG)), 150)).first is None


def test_the_audit_sees_a_filter_that_is_told_another_share():
    def told_less(task):
        noise = replace(task.noise, point_share=0.9 * task.noise.point_share)
        return resolve("slam")(replace(task, noise=noise))

    assert "landmark" in audit_drive(told_less, short()).first.block


@pytest.mark.parametrize("check", ["null-space", "nullity", "jacobians", "follow-the-records"])
@pytest.mark.parametrize("name", ["slam-transport", "slam-fej"])
def test_the_white_box_checks_hold_with_points(check, name):
    result = check_of(check)(resolve(name), short())
    assert result.outcome == "passed", result.reason


def test_with_points_the_papers_filter_loses_the_null_space():
    assert check_of("nullity")(resolve("slam"), short()).outcome != "passed"


@pytest.mark.parametrize("check", [c for c in CHECKS if c.startswith(("ignore", "hide"))])
def test_what_is_missing_changes_nothing(check):
    result = check_of(check)(resolve("slam"), short())
    assert result.outcome == "passed", result.reason


def test_a_missing_point_is_skipped_and_half_of_one_reported():
    drive = short()
    slam = resolve("slam")(drive.task)
    points = np.array([[1.0, 2.0, 3.0], [np.nan] * 3, [1.0, np.nan, 3.0]])
    frame = PointFrame(time_s=0.0, ids=np.arange(3), points=points, last=np.zeros(3, bool))
    innovation = slam.update(frame)
    assert innovation.born.tolist() == [0]
    assert innovation.skipped.tolist() == [2]
    again = slam.update(frame)
    assert (again.dof, again.whitened.shape) == (3, (1, 3))


@pytest.mark.parametrize("name", ["mapping-truth", "dead-reckoning", "slam-transport"])
def test_filters_run_on_points_and_are_measured(name):
    values = metrics(run(simulate(loads(SCENE)), resolve(name)))
    assert values["ate_rmse_m"] < 1.0
    if name == "slam-transport":
        assert 0.5 < values["nis_mean_per_dof"] < 2


def test_a_recording_gives_the_readings_back_to_the_last_bit(tmp_path):
    dataset = simulate(loads(SCENE))
    (path,) = write_dataset(dataset, tmp_path)
    back = read_dataset_mcap(path)
    for key in ("start", "ids", "points", "last"):
        assert np.array_equal(getattr(back.sightings, key), getattr(dataset.sightings, key))
    assert back.calibration.rig == dataset.calibration.rig
    assert (back.noise.point_share, back.noise.point_floor_m) == (0.02, 0.03)
    assert np.array_equal(back.noise.twist_share, dataset.noise.twist_share)
    described = info(path)
    assert described["told"]["point_share"] == 0.02
    assert described["problems"] == []
    record_run(back, "slam", resolve("slam"), tmp_path)


def test_a_npz_of_points_is_refused(tmp_path):
    with pytest.raises(DatasetError, match="point sensor; record scene as an MCAP"):
        write_npz(tmp_path / "a.npz", simulate(loads(SCENE)))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("option", "fault"),
    [
        ("filter.process_noise=twist", "imu.velocity.share: expected filter.process_noise"),
        ("camera.half_missing=0.1", "camera.half_missing: goes with a stereo pair"),
        ("told.baseline_scale=1.1", "told.baseline_scale: goes with a stereo pair"),
        ("point.range_m=[-1.0, 2.0]", "expected distances of at least 0"),
    ],
)
def test_what_would_be_without_effect_is_refused(option, fault):
    with pytest.raises(ScenarioError, match=fault):
        loads(SCENE, overrides=[option])
