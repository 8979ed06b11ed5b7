"""Readings of motion: twist samples with noise and bias, and a raw IMU."""

from dataclasses import replace
from typing import TypeAlias

import numpy as np

from simbench.dataset import RawImu
from simbench.rng import stream
from simbench.scenario import Scenario
from simbench.trajectory import Trajectory
from vislam.arrays import Array
from vislam.lie import se3
from vislam.types import Noise

#: One value, or one for each axis.
PerAxis: TypeAlias = float | tuple[float, float, float]

GRAVITY = np.array([0.0, 0.0, -9.80665])


def true_twists(scenario: Scenario, trajectory: Trajectory, times_s: Array) -> Array:
    """The twist of each sample without noise and bias, shape (T, 6).

    With `mean` it is the constant twist that leads from one frame to the next; the last sample,
    after which no frame comes, is instantaneous.
    """
    twists = trajectory.twist(times_s)
    if scenario.imu.twist == "mean":
        Ts = trajectory.T_world_imu(times_s)
        tau = np.diff(times_s)[:, None]
        twists[:-1] = se3.log(se3.inverse(Ts[:-1]) @ Ts[1:]) / tau
    return twists


def told_noise(scenario: Scenario) -> Noise:
    """What the filter is told: the model that `measured_twists` draws from, scaled."""
    model, told = scenario.filter.process_noise, scenario.told
    power = {"twist": 0, "twist-relative": 0, "twist-density": 0.5, "additive": 1}[model]
    sigma = told.twist_sigma_scale * _each_axis(scenario, "sigma") / scenario.rate_hz**power
    motion = Noise(
        process_model=model,
        process=np.diag(np.square(sigma)),
        twist_share=told.twist_sigma_scale * _each_axis(scenario, "share"),
        sigma_px=told.pixel_sigma_scale * np.broadcast_to(scenario.camera.sigma_px, 4),
    )
    if scenario.point is None:
        return motion
    return replace(
        motion,
        sigma_px=np.empty(0),
        point_share=told.pixel_sigma_scale * scenario.point.share,
        point_floor_m=told.pixel_sigma_scale * scenario.point.floor_m,
    )


def measured_twists(scenario: Scenario, seed: int, run: int, times_s: Array, true: Array) -> Array:
    """The samples as measured, shape (T, 6).

    `twist`: u = u_true + n, n ~ N(0, sigma^2). `twist-relative`: the same, where a component's
    sigma is share |u_true|, if that is more. `additive`: exp(tau u^) = exp(tau u_true^) exp(-w^),
    w ~ N(0, (sigma / rate)^2), so that T_true+ = T_true exp(tau u^) exp(w^). `twist-density`:
    n ~ N(0, sigma^2 / (rate tau)). The bias is added to the reading.
    """
    imu = scenario.imu
    sections = (("velocity", imu.velocity), ("angular_velocity", imu.angular_velocity))
    z = [
        stream(seed, run, "twist.noise", name).standard_normal((len(true), 3))
        for name, _ in sections
    ]
    sigma = np.maximum(_each_axis(scenario, "sigma"), _each_axis(scenario, "share") * np.abs(true))
    noise = sigma * np.concatenate(z, axis=1)
    tau = np.append(np.diff(times_s), 1 / scenario.rate_hz)
    measured = true + noise
    if scenario.filter.process_noise == "twist-density":
        measured = true + noise / np.sqrt(scenario.rate_hz * tau[:, None])
    if scenario.filter.process_noise == "additive":
        w = noise / scenario.rate_hz
        measured = se3.log(se3.exp(tau[:, None] * true) @ se3.exp(-w)) / tau[:, None]
    biases = [
        bias(stream(seed, run, "twist.bias", name), times_s, section.bias_sigma, section.bias_walk)
        for name, section in sections
    ]
    measured = measured + np.concatenate(biases, axis=1)
    return np.concatenate([measured[:, :3], never_zero(measured[:, 3:])], axis=1)


def raw_imu(
    scenario: Scenario, seed: int, run: int, trajectory: Trajectory, end_s: float
) -> RawImu | None:
    """A gyroscope and an accelerometer at their own rate, 0 to the end, where the scene has one.

    The specific force is R^T (a - g), with a = R (dv/dt + omega x v).
    """
    raw = scenario.imu.raw
    if raw is None:
        return None
    times_s = np.rint(np.arange(int(end_s * raw.rate_hz + 1e-6) + 1) / raw.rate_hz * 1e9) / 1e9
    twist, change = trajectory.twist(times_s), trajectory.acceleration(times_s)
    v, omega = twist[:, :3], twist[:, 3:]
    force = change[:, :3] + np.cross(omega, v)
    force -= np.einsum("nji,j->ni", trajectory.T_world_imu(times_s)[:, :3, :3], GRAVITY)

    def reading(name: str, true: Array, density: PerAxis, walk: PerAxis) -> tuple[Array, Array]:
        b = bias(stream(seed, run, "imu.bias", name), times_s, 0.0, walk)
        noise = stream(seed, run, "imu.noise", name).standard_normal(true.shape)
        return true + b + density * noise * np.sqrt(raw.rate_hz), b

    gyro, gyro_bias = reading("gyro", omega, raw.gyro_noise_density, raw.gyro_bias_walk)
    accel, accel_bias = reading("accel", force, raw.accel_noise_density, raw.accel_bias_walk)
    return RawImu(
        times_s=times_s,
        gyro=gyro,
        accel=accel,
        truth_gyro_bias=gyro_bias,
        truth_accel_bias=accel_bias,
    )


def bias(rng: np.random.Generator, times_s: Array, sigma: PerAxis, walk: PerAxis) -> Array:
    """A random walk from a random start, shape (n, 3).

    Args:
        rng: draws it.
        times_s: shape (n,).
        sigma: standard deviation at the start, one or for each axis.
        walk: growth of its variance is walk^2 a second, one or for each axis.
    """
    steps = rng.standard_normal((len(times_s), 3))
    steps[0] *= sigma
    steps[1:] *= np.sqrt(np.diff(times_s))[:, None] * walk
    return np.cumsum(steps, axis=0)


def never_zero(angular_velocity: Array) -> Array:
    """The rates, shape (n, 3), where one that is exactly zero turns by 1e-15 rad/s about z.

    Readers of the format divide by the norm.
    """
    still = ~angular_velocity.any(axis=1, keepdims=True)
    return np.where(still, [0.0, 0.0, 1e-15], angular_velocity)


def _each_axis(scenario: Scenario, key: str) -> Array:
    """A key of the noise of a sample of (v, omega), shape (6,)."""
    sections = (scenario.imu.velocity, scenario.imu.angular_velocity)
    return np.concatenate([np.broadcast_to(getattr(section, key), 3) for section in sections])
