"""The exact audit: right filters pass, planted mistakes are placed, a batch equals the loop."""

from dataclasses import replace

import numpy as np
import pytest

from simbench.checks.audit import audit, audit_drive
from simbench.checks.findings import ROUNDING
from simbench.checks.scenes import SCENES, drive
from simbench.checks.short_drive import ShortDrive
from simbench.errors import InputError
from simbench.filters import resolve
from simbench.scenario import load
from simbench.sensors import simulate
from tests.oracles.dense_ekf import DenseEkf
from vislam.filters import EkfSlam, Filter, Parts
from vislam.types import Belief, Innovation, Task

RIGHT = [
    "dead-reckoning",
    "mapping-truth",
    "slam",
    "slam-fej",
    "slam-transport",
    "slam-invariant",
    "slam-iterated",
    "slam-inverse-depth",
]


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("name", RIGHT)
def test_a_right_filter_passes_and_its_deviation_falls_as_eps_squared(name, scene):
    result = audit_drive(resolve(name), drive(scene))
    coarse, fine, finest = result.deviations
    assert result.passed, str(result)
    assert fine.block < 1e-5
    # what is left is nonlinearity, a hundredth at a tenth of the noise, or rounding
    assert fine.block < max(0.011 * coarse.block, ROUNDING)
    assert finest.block < max(0.011 * fine.block, ROUNDING)
    assert result.order is None or result.order == pytest.approx(2, abs=0.05)


def test_a_gate_is_on_in_the_scenes():
    assert sum(drive(scene).task.gate is not None for scene in SCENES) >= 3


def one_by_one(task: Task) -> Filter:
    """The same filter, which does not say that it takes a batch."""
    filter_ = EkfSlam(task)
    filter_.batched = False
    return filter_


def test_a_filter_without_a_batch_axis_is_judged_alike():
    short = ShortDrive.of(drive("births").dataset, 60)
    together, apart = audit_drive(EkfSlam, short), audit_drive(one_by_one, short)
    for a, b in zip(together.deviations, apart.deviations, strict=True):
        assert a.block == pytest.approx(b.block, abs=1e-10)
        assert a.joint_nees == pytest.approx(b.joint_nees, abs=1e-8)
        assert a.whiteness == pytest.approx(b.whiteness, abs=1e-10)


class Dense:
    """The dense EKF of the tests behind the protocol: a filter of somebody else."""

    def __init__(self, task: Task) -> None:
        self.ekf = DenseEkf(task.calibration, task.noise, task.prior, task.gate)

    def predict(self, motion, dt):
        self.ekf.predict(motion.vector, dt)

    def update(self, frame):
        self.ekf.update(frame.ids, frame.pixels)

    def belief(self, joint=False):
        ids = np.array(list(self.ekf.landmarks), int)
        blocks = [self.ekf.Sigma[self.ekf.rows[j], self.ekf.rows[j]] for j in ids]
        return Belief(
            T_world_imu=self.ekf.T.copy(),
            pose_covariance=self.ekf.Sigma[:6, :6].copy(),
            ids=ids,
            landmarks=np.array([self.ekf.landmarks[j] for j in ids]).reshape(-1, 3),
            landmark_covariances=np.array(blocks).reshape(-1, 3, 3),
            joint_covariance=self.ekf.Sigma.copy() if joint else None,
        )


@pytest.mark.slow
def test_a_filter_of_somebody_else_passes():
    result = audit_drive(Dense, drive("gaps"))
    assert result.passed
    assert result.deviations[0].nis is None


def without_cross_covariance(calibration, noise, T, T_linear, pixels):
    landmarks, G, R = Parts().birth(calibration, noise, T, T_linear, pixels)
    return landmarks, np.zeros_like(G), R


def wrong_sign(T, T_next):
    return Parts().transition(T_next, T)


def one_tenth_of_a_pixel_off(noise, predicted):
    return Parts().whitening(replace(noise, sigma_px=noise.sigma_px * 1.1), predicted)


@pytest.mark.parametrize(
    ("parts", "call", "block"),
    [
        (Parts(birth=without_cross_covariance), "update 0", "landmark covariance (age 0)"),
        (Parts(transition=wrong_sign), "predict 0", "pose-landmark cross-covariance"),
        (Parts(whitening=one_tenth_of_a_pixel_off), "update 1", "covariance"),
    ],
)
def test_a_planted_mistake_is_placed(parts, call, block):
    first = audit_drive(lambda task: EkfSlam(task, parts), drive("births")).first
    assert first.call == call
    assert block in first.block
    assert abs(first.deviation) > 1e-3


def test_a_filter_that_is_wrong_without_noise_is_said_to_be():
    def shifted(calibration, noise, T, T_linear, pixels):
        landmarks, G, R = Parts().birth(calibration, noise, T, T_linear, pixels)
        return landmarks + 0.01, G, R

    first = audit_drive(lambda task: EkfSlam(task, Parts(birth=shifted)), drive("births")).first
    assert first.block == "estimate"
    assert "even without noise" in str(first)


def test_a_filter_that_raises_is_a_result():
    class Raising(EkfSlam):
        def predict(self, motion, dt):
            raise ZeroDivisionError(f"no interval {dt} of {motion}"[:11])

    first = audit_drive(Raising, drive("births")).first
    assert str(first) == "predict 0 raised ZeroDivisionError: no interval"


def test_a_filter_that_claims_nothing_does_not_pass():
    class Silent(EkfSlam):
        def belief(self, joint=False):
            belief = super().belief(joint and False)
            nothing = np.empty((0, 3, 3))
            return replace(belief, pose_covariance=None, landmark_covariances=nothing)

        def finish(self):
            return self.belief()

    first = audit_drive(Silent, drive("births")).first
    assert "nothing to audit" in str(first)


def test_innovations_that_claim_too_much_are_found_where_the_state_is_right():
    class Boasting(EkfSlam):
        def update(self, frame) -> Innovation:
            innovation = super().update(frame)
            return replace(innovation, whitened=0.9 * innovation.whitened)

    first = audit_drive(Boasting, drive("births")).first
    assert first.block == "innovation covariance"
    assert first.call == "update 1"


def test_the_result_names_the_first_scene_that_failed():
    result = audit(resolve("slam-constant-prior"))
    assert not result.passed
    assert result.first == result.scenes[0].first
    values = result.as_json()
    assert values["first"]["call"] == "update 0"
    assert set(values["deviations"]) == {"0.01", "0.001", "0.0001"}
    assert {"pose_nees", "joint_nees", "nis", "whiteness"} <= set(values["deviations"]["0.001"])


def test_the_noise_of_a_short_drive_has_the_told_covariance():
    short = drive("additive")
    w = np.sqrt(short.scalars) * np.vstack([np.eye(short.scalars), -np.eye(short.scalars)])
    readings = short.realise(1e-4 * w)
    belief = replace(short.dataset.prior, T_world_imu=readings.prior.T_world_imu)
    e = belief.pose_error(short.T_world_imu[0]) / 1e-4
    assert e.T @ e / len(w) == pytest.approx(short.dataset.prior.pose_covariance, abs=1e-8)
    first = short.schedule[0]
    off = (readings.frames[0].pixels - readings.frames[0].pixels.mean(axis=0)) / 1e-4
    whole = (first.pixels != -1).all(axis=-1)
    sigma = np.sqrt(np.square(off).mean(axis=0))[whole]
    assert sigma == pytest.approx(np.broadcast_to(short.dataset.noise.sigma_px, sigma.shape))


def test_a_users_scene_takes_part_with_its_leading_frames():
    dataset = simulate(load("scenarios/figure8.yaml"))
    short = ShortDrive.of(dataset, 200)
    assert 2 <= short.frames < len(dataset)
    assert short.scalars <= 200
    assert ShortDrive.of(dataset, 400).frames > short.frames
    with pytest.raises(InputError, match="take landmarks away"):
        ShortDrive.of(dataset, 16)
    with pytest.raises(InputError, match="needs the truth"):
        ShortDrive.of(replace(dataset, truth=None), 200)


def test_the_linear_regime_is_told():
    calm = audit_drive(EkfSlam, drive("gaps")).noise_at_ten_percent
    wild = audit_drive(EkfSlam, drive("additive")).noise_at_ten_percent
    assert wild < 1 < calm
