"""Readings from truth: a scene, a seed and a run number make a dataset, to the byte."""

import numpy as np

from simbench import __version__, landmarks, trajectory
from simbench.dataset import Dataset, Origin, PointSightings, Sightings, Truth
from simbench.errors import InputError
from simbench.limits import LARGEST, beyond, refuse_above_limit
from simbench.rng import stream
from simbench.scenario import Scenario
from simbench.sensors import camera, inertial, point
from vislam.arrays import Array
from vislam.camera import StereoRig
from vislam.lie import se3, so3
from vislam.point import PointSensor
from vislam.types import Belief, Calibration

__all__ = ["seen_from", "simulate"]

#: While it is made: its true motion, pose and noise.
BYTES_PER_RAW_SAMPLE = 1024


@np.errstate(over="ignore", invalid="ignore")  # such numbers are refused at the end
def simulate(scenario: Scenario, seed: int | None = None, run: int = 0) -> Dataset:
    """Simulate a scene.

    Args:
        scenario: the scene.
        seed: instead of the scene's own.
        run: its number; runs of one seed share the scene, and differ in all noise.

    Raises:
        InputError: no landmark is ever seen, the data would take more than the limit, or numbers
            of the scene are beyond what can be computed with.
    """
    seed = scenario.seed if seed is None else seed
    drive = trajectory.make(scenario, seed)
    points = landmarks.make(scenario, drive, seed)
    _refuse_too_large(scenario, len(points))
    times_s = frame_times(scenario, seed, run)
    Ts_world_imu = drive.T_world_imu(times_s)
    true = inertial.true_twists(scenario, drive, times_s)
    measured = inertial.measured_twists(scenario, seed, run, times_s, true)
    sightings: Sightings | PointSightings
    if scenario.point is None:
        sightings = camera.sightings(scenario, seed, run, Ts_world_imu, points)
    else:
        sightings = point.sightings(scenario, scenario.point, seed, run, Ts_world_imu, points)
    if not len(sightings):
        raise InputError(_nothing_seen(scenario, len(points)))
    dataset = Dataset(
        name=scenario.name,
        times_s=times_s,
        linear_velocity=measured[:, :3],
        angular_velocity=measured[:, 3:],
        landmark_count=len(points),
        sightings=sightings,
        calibration=_told_calibration(scenario),
        noise=inertial.told_noise(scenario),
        prior=_prior(scenario, seed, run, Ts_world_imu[0]),
        gate=scenario.filter.gate_probability,
        imu=inertial.raw_imu(scenario, seed, run, drive, float(times_s[-1])),
        truth=Truth(
            T_world_imu=Ts_world_imu,
            landmarks=points,
            linear_velocity=true[:, :3],
            angular_velocity=true[:, 3:],
            calibration=Calibration(rig=_rig(scenario), T_imu_cam=scenario.rig.T_imu_cam),
        ),
        origin=Origin(scenario_yaml=scenario.to_yaml(), seed=seed, run=run, version=__version__),
    )
    if (name := beyond(dataset, "dataset")) is not None:
        raise InputError(
            f"{scenario.name}: its numbers are too large or too small to compute with: "
            f"what becomes of {name} is not finite, or above {LARGEST:g}."
        )
    return dataset


def seen_from(calibration: Calibration, p_imu: Array) -> Array:
    """What the sensor reads of points in the IMU frame, without noise, (n, 3) to (n, c)."""
    if isinstance(calibration.rig, PointSensor):
        return point.relative(calibration.T_imu_cam, p_imu)
    matrices = camera.camera_matrices(calibration.rig, calibration.T_imu_cam)
    return camera.projected(matrices, p_imu)[0]


def _nothing_seen(scenario: Scenario, landmarks: int) -> str:
    none = f"{scenario.name}: no landmark is ever seen: expected some of the {landmarks} within"
    if scenario.point is not None:
        return (
            f"{none} range_m {list(scenario.point.range_m)} and the cone of "
            f"{scenario.point.view_deg:g} degrees, in front of the walls; move landmarks to the "
            "path, widen point.range_m, or look at rig.imu_cam and camera."
        )
    return (
        f"{none} depth_m {list(scenario.rig.depth_m)} and in both images, in front of the walls; "
        "move landmarks to the path, widen rig.depth_m, or look at rig.imu_cam and camera."
    )


def _refuse_too_large(scenario: Scenario, count: int) -> None:
    """Hold what a scene asks for against the limit, before it is made."""
    frames = round(scenario.duration_s * scenario.rate_hz) + 1
    what = f"a scene of {count} landmarks and {frames} frames, as a dense array of features,"
    refuse_above_limit(scenario.name, what, 4 * 8 * count * frames)
    if (raw := scenario.imu.raw) is not None:
        samples = scenario.duration_s * raw.rate_hz
        what = f"a raw IMU of {samples:.4g} samples"
        refuse_above_limit(scenario.name, what, int(BYTES_PER_RAW_SAMPLE * samples))


def frame_times(scenario: Scenario, seed: int, run: int) -> Array:
    """Times of the frames, whole nanoseconds from 0, each jittered about its regular time."""
    count = round(scenario.duration_s * scenario.rate_hz) + 1
    places = np.arange(count, dtype=float)
    if scenario.time_jitter:
        u = stream(seed, run, "time").uniform(-0.5, 0.5, count)
        places[1:] += scenario.time_jitter * u[1:]
    return np.rint(places / scenario.rate_hz * 1e9) / 1e9


def _rig(scenario: Scenario, baseline_scale: float = 1.0) -> StereoRig | PointSensor:
    rig, sensor = scenario.rig, scenario.point
    if sensor is not None:
        return PointSensor(range_m=sensor.range_m, view_deg=sensor.view_deg)
    return StereoRig(
        fx_px=rig.fx_px,
        fy_px=rig.fy_px,
        cx_px=rig.cx_px,
        cy_px=rig.cy_px,
        baseline_m=baseline_scale * rig.baseline_m,
        image_px=rig.image_px,
        min_disparity_px=camera.MIN_DISPARITY_PX,
    )


def _told_calibration(scenario: Scenario) -> Calibration:
    """The truth, turned in the camera's own frame and moved in the IMU's, as the scene says."""
    told = scenario.told
    T_imu_cam = scenario.rig.T_imu_cam.copy()
    T_imu_cam[:3, :3] @= so3.exp(np.deg2rad(told.rotation_error_deg))
    T_imu_cam[:3, 3] += told.translation_error_m
    return Calibration(rig=_rig(scenario, told.baseline_scale), T_imu_cam=T_imu_cam)


def _prior(scenario: Scenario, seed: int, run: int, T_world_imu: Array) -> Belief:
    """T_hat = T_true exp(-xi), xi ~ N(0, P0), so that the error in the right chart is xi."""
    prior = scenario.prior
    sigma = np.concatenate(
        [
            np.broadcast_to(prior.sigma_translation_m, 3),
            np.broadcast_to(np.deg2rad(prior.sigma_rotation_deg), 3),
        ]
    )
    xi = sigma * stream(seed, run, "prior").standard_normal(6)
    return Belief(T_world_imu=T_world_imu @ se3.exp(-xi), pose_covariance=np.diag(np.square(sigma)))
