"""Readings of motion and the rest of what `simulate` says, against definitions and statistics."""

import numpy as np
import pytest
from scipy.linalg import expm, logm
from scipy.stats import chi2, norm

from simbench import trajectory
from simbench.errors import InputError
from simbench.sensors import _prior as draw_prior
from simbench.sensors import frame_times, simulate
from simbench.sensors.inertial import measured_twists, never_zero
from tests.simbench.scenes import PLAIN, RICH, differences, scene

SILENT = {"velocity": {"sigma": 0.0}, "angular_velocity": {"sigma": 0.0}}


def hat(u):
    """The 4x4 matrices of twists, shape (n, 6)."""
    v, (x, y, z), o = u[:, :3].T, u[:, 3:].T, np.zeros(len(u))
    rows = [[o, -z, y, v[0]], [z, o, -x, v[1]], [-y, x, o, v[2]], [o, o, o, o]]
    return np.moveaxis(np.array(rows), -1, 0)


def vee(M):
    """The twists of 4x4 matrices xi^, shape (n, 6)."""
    return np.stack([*M[:, :3, 3].T, M[:, 2, 1], M[:, 0, 2], M[:, 1, 0]], axis=1)


def log_series(M):
    """The logarithm of matrices near the identity, by its series: (M - I) - (M - I)^2 / 2 + ..."""
    X, power, total = M - np.eye(4), np.eye(4), np.zeros_like(M)
    for k in range(1, 120):
        power = power @ X
        total += power * (-1) ** (k + 1) / k
    return total


def twists(data):
    return np.concatenate([data.linear_velocity, data.angular_velocity], axis=1)


def true_twists(data):
    return np.concatenate([data.truth.linear_velocity, data.truth.angular_velocity], axis=1)


def white(z, alpha):
    """Hold columns against independent standard normals: means, variances, correlations, lag 1.

    Two-sided; alpha is the false-alarm rate of all together.
    """
    n, k = z.shape
    each = alpha / (3 * k + k * (k - 1) / 2)
    assert np.abs(z.mean(axis=0)).max() * np.sqrt(n) < norm.isf(each / 2)
    low, high = chi2.ppf([each / 2, 1 - each / 2], n)
    sums = np.square(z).sum(axis=0)
    assert low < sums.min()
    assert sums.max() < high
    r = np.corrcoef(z.T)[np.triu_indices(k, 1)]
    assert np.abs(np.arctanh(r)).max() * np.sqrt(n - 3) < norm.isf(each / 2)
    lagged = (z[1:] * z[:-1]).mean(axis=0) * np.sqrt(n - 1)
    assert np.abs(lagged).max() < norm.isf(each / 2)


def test_the_mean_twist_integrates_to_the_true_poses():
    data = simulate(scene(time_jitter=0.8))
    Ts, tau = data.truth.T_world_imu, np.diff(data.times_s)
    steps = expm(hat(tau[:, None] * true_twists(data)[:-1]))
    np.testing.assert_allclose(Ts[:-1] @ steps, Ts[1:], rtol=0, atol=1e-12)


@pytest.mark.parametrize("twist", ["mean", "instantaneous"])
def test_the_last_sample_and_every_instantaneous_one_is_the_derivative_of_the_pose(twist):
    """T^-1 dT/dt by central differences."""
    a_scene = scene(imu={"twist": twist})
    data, h = simulate(a_scene), 1e-5
    t = data.times_s
    drive = trajectory.make(a_scene, a_scene.seed)
    rate = (drive.T_world_imu(t + h) - drive.T_world_imu(t - h)) / (2 * h)
    expected = np.linalg.inv(drive.T_world_imu(t)) @ rate
    at = slice(None) if twist == "instantaneous" else slice(-1, None)
    np.testing.assert_allclose(hat(true_twists(data))[at], expected[at], atol=1e-8)


def test_twist_noise_is_white_with_the_sigma_of_each_axis():
    """4,001 samples; 1 false alarm in 1,000."""
    noise = {
        "velocity": {"sigma": [0.1, 0.2, 0.3]},
        "angular_velocity": {"sigma": [0.01, 0.02, 0.03]},
    }
    data = simulate(scene(duration_s=400.0, imu=noise, time_jitter=0.5))
    z = (twists(data) - true_twists(data)) / [0.1, 0.2, 0.3, 0.01, 0.02, 0.03]
    white(z, 1e-3)
    # as large whatever the interval
    tau, scale = np.diff(data.times_s), np.square(z[:-1]).sum(axis=1)
    r = np.corrcoef(tau, scale)[0, 1]
    assert abs(np.arctanh(r)) * np.sqrt(len(tau) - 3) < norm.isf(1e-3 / 2)


def test_additive_noise_is_that_of_the_step_in_the_right_chart():
    """w = log(exp(tau u)^-1 exp(tau u_true)), 1,000 steps of about 1 rad; 1 in 1,000."""
    noise = {
        "velocity": {"sigma": [1.0, 2.0, 3.0]},
        "angular_velocity": {"sigma": [0.5, 1.0, 1.5]},
    }
    a_scene = scene(imu=noise, filter={"process_noise": "additive"})
    times = frame_times(scene(duration_s=100.0, time_jitter=0.5), 0, 0)
    true = np.tile([30.0, -20.0, 10.0, 5.0, 8.0, -6.0], (1001, 1))
    tau = np.diff(times)[:, None]
    measured = measured_twists(a_scene, 0, 0, times, true)
    steps = (expm(hat(tau * u[:-1])) for u in (measured, true))
    w = vee(log_series(np.linalg.solve(*steps)))
    told = simulate(a_scene).noise
    assert told.process_model == "additive"
    np.testing.assert_allclose(np.sqrt(np.diag(told.process)), [0.1, 0.2, 0.3, 0.05, 0.1, 0.15])
    white(w / np.sqrt(np.diag(told.process)), 1e-3)


def test_a_twist_bias_starts_at_its_sigma_and_walks():
    """300 runs of 21 samples; starts, and increments over the root of time, standard normal."""
    section = {"sigma": 0.0, "bias_sigma": [0.1, 0.2, 0.3], "bias_walk": [0.3, 0.2, 0.1]}
    a_scene = scene(imu={"velocity": section, "angular_velocity": section})
    times = frame_times(scene(duration_s=2.0, time_jitter=0.5), 0, 0)
    true = np.full((21, 6), 0.7)
    bias = np.array([measured_twists(a_scene, 0, run, times, true) - true for run in range(300)])
    white(bias[:, 0] / np.tile(section["bias_sigma"], 2), 1e-3)
    steps = np.diff(bias, axis=1) / np.sqrt(np.diff(times))[:, None]
    white(steps.reshape(-1, 6) / np.tile(section["bias_walk"], 2), 1e-3)


def raw(duration_s=10.0, **keys):
    quiet = dict.fromkeys(
        ("gyro_noise_density", "accel_noise_density", "gyro_bias_walk", "accel_bias_walk"), 0.0
    )
    base = {"kind": "figure8", "size_m": [12.0, 8.0], "roll_deg": 10.0, "pitch_deg": 10.0}
    a_scene = scene(
        duration_s=duration_s, trajectory=base, imu={"raw": {"rate_hz": 100.0, **quiet, **keys}}
    )
    return a_scene, simulate(a_scene)


def test_raw_readings_are_the_rate_and_the_specific_force():
    """R^T (d2p/dt2 - g) by central differences of the position."""
    a_scene, data = raw()
    t, h = data.imu.times_s, 1e-3
    drive = trajectory.make(a_scene, a_scene.seed)
    before, now, after = (drive.T_world_imu(t + d) for d in (-h, 0.0, h))
    a_world = (before - 2 * now + after)[:, :3, 3] / h**2
    force = np.einsum("nji,nj->ni", now[:, :3, :3], a_world - np.array([0.0, 0.0, -9.80665]))
    np.testing.assert_allclose(data.imu.accel, force, atol=1e-5)
    rate = np.linalg.inv(now) @ (after - before) / (2 * h)
    np.testing.assert_allclose(data.imu.gyro, rate[:, [2, 0, 1], [1, 2, 0]], atol=1e-5)


def test_at_rest_the_accelerometer_reads_gravity_upwards():
    still = {"kind": "hover", "sway_m": [0, 0, 0], "yaw_deg": 0}
    quiet = {"gyro_noise_density": 0.0, "accel_noise_density": 0.0}
    walks = {"gyro_bias_walk": 0.0, "accel_bias_walk": 0.0}
    data = simulate(scene(trajectory=still, imu={"raw": quiet | walks}, landmarks={"kind": "box"}))
    np.testing.assert_allclose(data.imu.accel, [[0, 0, 9.80665]] * len(data.imu.accel), atol=1e-12)


def test_raw_times_are_their_own_from_zero_to_the_end():
    a_scene, data = raw(duration_s=3.0)
    np.testing.assert_array_equal(data.imu.times_s, np.arange(301) / 100)
    assert data.times_s[-1] == a_scene.duration_s


def test_raw_noise_has_the_density_and_its_bias_walks():
    """10,001 samples of 6 axes; 1 false alarm in 1,000 for noise and for bias."""
    densities = {"gyro_noise_density": [1e-3, 2e-3, 3e-3], "accel_noise_density": 0.02}
    walks = {"gyro_bias_walk": 1e-3, "accel_bias_walk": [0.1, 0.2, 0.3]}
    _, quiet = raw(100.0)
    _, noisy = raw(100.0, **densities, **walks)
    imu, bias = noisy.imu, (noisy.imu.truth_gyro_bias, noisy.imu.truth_accel_bias)
    gyro, accel = imu.gyro - quiet.imu.gyro - bias[0], imu.accel - quiet.imu.accel - bias[1]
    sigma = [0.01, 0.02, 0.03, 0.2, 0.2, 0.2]
    white(np.concatenate([gyro, accel], axis=1) / sigma, 1e-3)
    steps = np.concatenate([np.diff(b, axis=0) for b in bias], axis=1)
    white(steps / (0.1 * np.array([1e-3, 1e-3, 1e-3, 0.1, 0.2, 0.3])), 1e-3)
    assert not bias[0][0].any()
    assert not bias[1][0].any()


def test_times_are_whole_nanoseconds_jittered_about_their_places():
    """400 shares of the period, uniform over +-0.4; two-sided, 1 false alarm in 1,000."""
    from scipy.stats import kstest

    a_scene = scene(time_jitter=0.8, duration_s=40.0, rate_hz=9.7)
    times = frame_times(a_scene, 1, 2)
    assert len(times) == round(40 * 9.7) + 1
    assert times[0] == 0
    np.testing.assert_array_equal(times, np.rint(times * 1e9) / 1e9)
    shares = (times * 9.7 - np.arange(len(times)))[1:]
    assert kstest(shares, "uniform", (-0.4, 0.8)).pvalue > 1e-3


def test_without_jitter_times_are_regular():
    np.testing.assert_array_equal(frame_times(scene(), 0, 0), np.arange(101) / 10)


def test_the_prior_is_what_the_initial_error_is_drawn_from():
    """200 runs, in the right chart, with sigmas so large that charts differ; 1 in 1,000."""
    prior = {"sigma_translation_m": [0.5, 1.0, 2.0], "sigma_rotation_deg": [10.0, 20.0, 30.0]}
    T_world_imu = expm(hat(np.array([[30.0, -20.0, 5.0, 0.3, -0.7, 1.7]])))[0]
    beliefs = [draw_prior(scene(prior=prior), 0, run, T_world_imu) for run in range(200)]
    steps = [logm(np.linalg.solve(belief.T_world_imu, T_world_imu)).real for belief in beliefs]
    errors, P = vee(np.array(steps)), beliefs[0].pose_covariance
    sigma = [0.5, 1.0, 2.0, *np.deg2rad([10.0, 20.0, 30.0])]
    np.testing.assert_allclose(P, np.diag(np.square(sigma)), rtol=1e-15)
    white(errors / sigma, 1e-3)
    np.testing.assert_allclose(beliefs[0].pose_error(T_world_imu), errors[0], atol=1e-9)


def test_a_scene_starts_from_a_draw_of_its_prior():
    data = simulate(scene(RICH), 5, 1)
    drawn = draw_prior(scene(RICH), 5, 1, data.truth.T_world_imu[0])
    assert not differences(data.prior, drawn)
    assert (drawn.T_world_imu != data.truth.T_world_imu[0]).any()


def test_the_filter_is_told_what_the_scene_says_it_is_told():
    data, a_scene = simulate(scene(RICH)), scene(RICH)
    true, told = data.truth.calibration, data.calibration
    assert told.rig.baseline_m == pytest.approx(1.01 * true.rig.baseline_m, rel=1e-15)
    assert (told.rig.fx_px, told.rig.image_px) == (true.rig.fx_px, true.rig.image_px)
    np.testing.assert_allclose(
        told.T_imu_cam[:3, 3] - true.T_imu_cam[:3, 3], [0.01, 0.02, -0.03], atol=1e-15
    )
    turn = expm(hat(np.deg2rad([[0, 0, 0, 0.1, -0.2, 0.3]])))[0, :3, :3]
    np.testing.assert_allclose(told.T_imu_cam[:3, :3], true.T_imu_cam[:3, :3] @ turn, atol=1e-15)
    np.testing.assert_allclose(data.noise.sigma_px, 1.5 * np.array(a_scene.camera.sigma_px))
    sigma = 0.7 * np.array([0.1, 0.2, 0.3, 0.01, 0.02, 0.03])
    np.testing.assert_allclose(data.noise.process, np.diag(sigma**2), rtol=1e-14)
    assert data.gate == 0.999


def test_without_errors_the_filter_is_told_the_truth_to_the_bit():
    data = simulate(scene(rig={"imu_cam": {"rotvec_deg": [3.0, -5.0, 8.0]}}))
    assert not differences(data.calibration, data.truth.calibration)
    assert data.gate is None


def test_equal_scene_seed_and_run_give_equal_readings_and_others_do_not():
    a_scene = scene(RICH)
    data = simulate(a_scene, 5, 1)
    assert not differences(data, simulate(scene(RICH), 5, 1))
    another_run, another_seed = simulate(a_scene, 5, 2), simulate(a_scene, 6, 1)
    assert ".truth.landmarks" not in differences(data, another_run)
    assert ".truth.landmarks" in differences(data, another_seed)
    for other in (another_run, another_seed):
        assert (data.imu.accel[:400] != other.imu.accel[:400]).any()
        assert (data.linear_velocity != other.linear_velocity).any()


def test_the_origin_makes_the_dataset_again():
    from simbench.scenario import loads

    data = simulate(scene(RICH), 5, 1)
    origin = data.origin
    again = simulate(loads(origin.scenario_yaml), origin.seed, origin.run)
    assert not differences(data, again)


def test_the_scenes_own_seed_is_the_default():
    assert not differences(simulate(scene(RICH)), simulate(scene(RICH), RICH["seed"], 0))


def test_a_scene_in_which_nothing_is_seen_says_what_to_change():
    with pytest.raises(InputError, match=r"plain: no landmark is ever seen: .* widen rig.depth_m"):
        simulate(scene(rig={"depth_m": [0.01, 0.02]}))


def test_a_tracked_scene_in_which_nothing_is_seen_says_so_too():
    with pytest.raises(InputError, match="no landmark is ever seen"):
        simulate(scene(rig={"depth_m": [0.01, 0.02]}, camera={"tracks": {}}))


def test_no_rate_is_exactly_zero():
    still = {"kind": "hover", "sway_m": [0, 0, 0], "yaw_deg": 0}
    data = simulate(scene(PLAIN, trajectory=still, imu=SILENT, landmarks={"kind": "box"}))
    assert (np.linalg.norm(data.angular_velocity, axis=1) > 0).all()
    assert np.abs(data.angular_velocity).max() < 1e-12
    rates = np.array([[0.0, 0.0, 0.0], [0.0, 1e-3, 0.0]])
    np.testing.assert_array_equal(never_zero(rates), [[0, 0, 1e-15], [0, 1e-3, 0]])
