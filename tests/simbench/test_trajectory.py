from decimal import Decimal
from functools import reduce
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from simbench import trajectory
from simbench.poses import Format, Poses, write_poses, write_tum
from simbench.scenario import TRAJECTORIES, load, loads

POINTS = [[0.0, 0.0, 0.0], [10.0, 1.0, 0.5], [15.0, 8.0, 1.0], [8.0, 12.0, -1.0], [2.0, 7.0, 0.0]]
TIMES = [0.0, 5.0, 9.0, 14.0, 20.0]
QUATERNIONS = Rotation.from_euler(
    "xyz", [[0, 0, 0], [10, 5, 20], [-20, 9, 80], [5, -30, 150], [0, 0, 200]], degrees=True
).as_quat()
THROUGH = f"kind: waypoints, points: {POINTS}"
SPLINES = {
    "heading": THROUGH,
    "timed": f"{THROUGH}, times_s: {TIMES}",
    "attitude": f"{THROUGH}, times_s: {TIMES}, attitude_deg: "
    "[[0, 0, 0], [10, 20, 30], [0, -20, 80], [40, 0, 170], [0, 0, -160]]",
    "quaternions": f"{THROUGH}, times_s: {TIMES}, quaternions: {QUATERNIONS.tolist()}",
}
RECORDED = "\\n".join(
    " ".join(map(repr, [100.0 + t, *p, *q]))
    for t, p, q in zip(TIMES, POINTS, QUATERNIONS.tolist(), strict=True)
)
MOTIONS = {
    **{kind: f"kind: {kind}" for kind in TRAJECTORIES if kind not in ("waypoints", "file")},
    **SPLINES,
    "file": f'kind: file, text: "{RECORDED}"',
}

motions = st.sampled_from(sorted(MOTIONS))
sways = st.tuples(st.floats(0, 40), st.floats(0, 40), st.floats(1, 9), st.floats(1, 9))
seeds = st.integers(0, 1000)


def make(name, sway=(4.0, 3.0, 5.0, 7.0), start=None, seed=0):
    roll, pitch, roll_period, pitch_period = sway
    keys = (
        f"{MOTIONS[name]}, roll_deg: {roll!r}, pitch_deg: {pitch!r}, "
        f"roll_period_s: {roll_period!r}, pitch_period_s: {pitch_period!r}"
    )
    if start is not None:
        keys += f", start: {start}"
    return trajectory.make(loads(f"trajectory: {{{keys}}}\nduration_s: 20"), seed)


def derivative(function, t, h=2e-3):
    """The central difference of eighth order: truncation h^8 / 630 times the ninth derivative."""
    weights = [1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280]
    return sum(w * function(t + k * h) for k, w in zip(range(-4, 5), weights, strict=True)) / h


def knots(name):
    """Where the pieces of a spline meet; a heading has seven knots between two waypoints."""
    if name not in (*SPLINES, "file"):
        return np.empty(0)
    ends = np.array(TIMES)
    if name == "heading":
        distance = np.cumsum(np.linalg.norm(np.diff(POINTS, axis=0), axis=1))
        ends = 20 * np.array([0, *distance]) / distance[-1]
    return np.interp(np.linspace(0, len(ends) - 1, 8 * len(ends) - 7), range(len(ends)), ends)


def away_from_knots(name, t):
    """Times at which the spline is one polynomial within the reach of a difference."""
    return t[(np.abs(np.subtract.outer(t, knots(name))) > 0.02).all(axis=1)]


def hat(u):
    """The 4x4 matrices of twists (v, omega), written out."""
    vx, vy, vz, x, y, z = u.T
    o = np.zeros_like(x)
    rows = [[o, -z, y, vx], [z, o, -x, vy], [-y, x, o, vz], [o, o, o, o]]
    return np.moveaxis(np.array(rows), -1, 0)


times = st.lists(st.floats(-5, 25), min_size=1, max_size=20).map(np.array)


@given(name=motions, t=times, sway=sways, seed=seeds)
def test_the_twist_is_the_derivative_of_the_pose(name, t, sway, seed):
    body = make(name, sway, seed=seed)
    t = away_from_knots(name, t)
    xi_hat = np.linalg.inv(body.T_world_imu(t)) @ derivative(body.T_world_imu, t)
    np.testing.assert_allclose(hat(body.twist(t)), xi_hat, rtol=0, atol=1e-9)


@given(name=motions, t=times, sway=sways, seed=seeds)
def test_the_acceleration_is_the_derivative_of_the_twist(name, t, sway, seed):
    body = make(name, sway, seed=seed)
    t = away_from_knots(name, t)
    np.testing.assert_allclose(body.acceleration(t), derivative(body.twist, t), rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", sorted(MOTIONS))
def test_integrating_the_twist_gives_the_pose(name):
    # Magnus' integrator of fourth order for T' = T u^, with Gauss' two points to a step.
    body, steps = make(name), 4000
    h = 12 / steps
    middles = h * (np.arange(steps) + 0.5)
    u1, u2 = (hat(body.twist(middles + side * h / np.sqrt(12))) for side in (-1, 1))
    increments = expm(h / 2 * (u1 + u2) + np.sqrt(3) / 12 * h * h * (u1 @ u2 - u2 @ u1))
    first, last = body.T_world_imu(np.array([0.0, 12.0]))
    np.testing.assert_allclose(reduce(np.matmul, increments, first), last, rtol=0, atol=1e-8)


@given(name=motions, t=times, sway=sways)
def test_poses_are_rigid_motions(name, t, sway):
    Ts = make(name, sway).T_world_imu(t)
    assert Ts.shape == (len(t), 4, 4)
    R = Ts[:, :3, :3]
    np.testing.assert_allclose(
        R @ np.swapaxes(R, 1, 2), np.broadcast_to(np.eye(3), R.shape), atol=1e-13
    )
    assert (np.linalg.det(R) > 0).all()


@pytest.mark.parametrize("name", sorted(MOTIONS))
def test_it_starts_where_the_scene_says(name):
    at_zero = np.zeros(1)
    np.testing.assert_allclose(
        make(name, start="identity").T_world_imu(at_zero)[0], np.eye(4), atol=1e-14
    )
    body = make(name, start="{translation_m: [1, 2, 3], rotvec_deg: [0, 0, 90]}")
    np.testing.assert_allclose(
        body.T_world_imu(at_zero)[0],
        [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]],
        atol=1e-14,
    )


@given(name=motions, t=times)
def test_moving_the_start_moves_the_whole_and_changes_no_reading(name, t):
    here, there = make(name, start="identity"), make(name, start="{rotvec_deg: [20, 30, 40]}")
    T = there.T_world_imu(np.zeros(1))[0]
    np.testing.assert_allclose(there.T_world_imu(t), T @ here.T_world_imu(t), atol=1e-12)
    np.testing.assert_array_equal(there.twist(t), here.twist(t))
    np.testing.assert_array_equal(there.acceleration(t), here.acceleration(t))


@pytest.mark.parametrize("name", ["timed", "attitude", "quaternions", "file"])
def test_waypoints_are_passed_through_in_time(name):
    Ts = make(name, (0.0, 0.0, 5.0, 5.0)).T_world_imu(np.array(TIMES))
    np.testing.assert_allclose(Ts[:, :3, 3], POINTS, atol=1e-12)
    if name in ("quaternions", "file"):
        expected = Rotation.from_quat(QUATERNIONS).as_matrix()
        np.testing.assert_allclose(Ts[:, :3, :3], expected, atol=1e-12)
    if name == "attitude":
        expected = expm(np.deg2rad(30) * np.array([[0, -1, 0], [1, 0, 0], [0, 0, 0]]))
        expected = expected @ expm(np.deg2rad(20) * np.array([[0, 0, 1], [0, 0, 0], [-1, 0, 0]]))
        expected = expected @ expm(np.deg2rad(10) * np.array([[0, 0, 0], [0, 0, -1], [0, 1, 0]]))
        np.testing.assert_allclose(Ts[1, :3, :3], expected, atol=1e-12)


def test_waypoints_without_times_share_the_duration_out_by_distance():
    body = make("heading", (0.0, 0.0, 5.0, 5.0))
    steps = np.linalg.norm(np.diff(POINTS, axis=0), axis=1)
    t = 20 * np.concatenate([[0], np.cumsum(steps)]) / steps.sum()
    np.testing.assert_allclose(body.T_world_imu(t)[:, :3, 3], POINTS, atol=1e-12)


@pytest.mark.parametrize("name", [*SPLINES, "file"])
def test_acceleration_is_continuous_at_the_waypoints(name):
    body, step = make(name), 1e-7
    # Also where a natural spline goes over into a straight line; given rotations have no such end.
    instants = knots(name)[1:-1] if name in ("quaternions", "file") else knots(name)
    # The steepest change is some hundreds a second, so what is no jump stays below 1e-4.
    before, after = (body.acceleration(instants + side) for side in (-step, step))
    np.testing.assert_allclose(after, before, rtol=0, atol=1e-4)


@pytest.mark.parametrize("name", ["heading", "timed", "attitude"])
def test_beyond_its_ends_a_spline_goes_on_straight(name):
    body = make(name, (0.0, 0.0, 5.0, 5.0), start="given")
    for t in (np.array([-3.0, -2.0, -1.0]), np.array([21.0, 22.0, 23.0])):
        p = body.T_world_imu(t)[:, :3, 3]
        np.testing.assert_allclose(p[2] - p[1], p[1] - p[0], atol=1e-12)


@pytest.mark.parametrize("name", ["straight", "circle", "figure8", "helix", "heading", "timed"])
def test_the_body_looks_where_it_goes(name):
    body = make(name, (0.0, 0.0, 5.0, 5.0))
    v = body.twist(np.linspace(0, 20, 501))[:, :3]
    level = np.linalg.norm(v[:, :2], axis=1)
    slip = np.arctan2(v[:, 1], v[:, 0])
    assert np.abs(slip[level > 0.1]).max() < (1e-12 if name not in SPLINES else np.deg2rad(1))


def test_a_path_that_stands_still_or_goes_straight_up_has_a_heading():
    for points in ("[[0, 0, 0], [0, 0, 5]]", "[[0, 0, 0], [0, 0, 0], [4, 4, 0], [4, 4, 0]]"):
        times_s = "[0, 5]" if points.count("[") == 3 else "[0, 2, 5, 7]"
        scene = loads(f"trajectory: {{kind: waypoints, points: {points}, times_s: {times_s}}}")
        motion = trajectory.make(scene, 0).at(np.linspace(0, scene.duration_s, 101))
        assert np.isfinite(motion.T).all()
        assert np.isfinite(motion.acceleration).all()


def test_a_circle_and_a_figure_eight_close_and_turn_as_they_should():
    t = np.linspace(0, 20, 2001)
    circle = trajectory.make(
        loads("trajectory: {kind: circle, radius_m: 3, laps: 1}\nduration_s: 20"), 0
    )
    Ts = circle.T_world_imu(t)
    np.testing.assert_allclose(Ts[-1], np.eye(4), atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(Ts[:, :2, 3] - [0, 3], axis=1), 3)
    np.testing.assert_allclose(
        circle.twist(t),
        np.broadcast_to([2 * np.pi * 3 / 20, 0, 0, 0, 0, 2 * np.pi / 20], (2001, 6)),
        atol=1e-12,
    )
    eight = trajectory.make(
        loads(
            "trajectory: {kind: figure8, size_m: [20, 10], laps: 2, start: given}\nduration_s: 20"
        ),
        0,
    )
    p = eight.T_world_imu(t)[:, :3, 3]
    np.testing.assert_allclose(np.ptp(p, axis=0), [20, 10, 0], rtol=1e-4)
    np.testing.assert_allclose(p[[0, 500, 1000, 2000]], 0, atol=1e-12)


def test_a_helix_climbs_over_the_whole_duration():
    body = trajectory.make(loads("trajectory: {kind: helix, climb_m: 6}\nduration_s: 20"), 0)
    np.testing.assert_allclose(
        body.T_world_imu(np.array([0.0, 10.0, 20.0]))[:, 2, 3], [0, 3, 6], atol=1e-12
    )


@given(seed=seeds, sizes=st.tuples(*[st.floats(0, 50)] * 3), yaw=st.floats(0, 170))
def test_a_random_motion_keeps_its_bounds_and_its_seed(seed, sizes, yaw):
    scene = loads(
        f"trajectory: {{kind: random, size_m: {list(sizes)}, yaw_deg: {yaw!r}, start: given}}"
    )
    t = np.linspace(0, 500, 401)
    Ts = trajectory.make(scene, seed).T_world_imu(t)
    assert (np.abs(Ts[:, :3, 3]) <= np.array(sizes) / 2 + 1e-12).all()
    heading = np.arctan2(Ts[:, 1, 0], Ts[:, 0, 0])
    assert np.abs(heading).max() <= np.deg2rad(yaw) + 1e-12
    np.testing.assert_array_equal(trajectory.make(scene, seed).T_world_imu(t), Ts)
    if min(sizes) > 0:
        assert (trajectory.make(scene, seed + 1).T_world_imu(t) != Ts).any()


def test_the_drive_has_the_size_of_the_real_one():
    scene = load(Path(__file__).parents[2] / "scenarios" / "drive.yaml")
    assert round(scene.duration_s * scene.rate_hz) + 1 == 1010
    t = np.linspace(0, scene.duration_s, 5001)
    p = trajectory.make(scene, scene.seed).T_world_imu(t)[:, :3, 3]
    assert np.linalg.norm(np.diff(p, axis=0), axis=1).sum() == pytest.approx(1342, abs=10)


def test_a_recorded_trajectory_comes_back_through_a_file(tmp_path):
    t = np.arange(0, 10, 0.05)
    true = make("figure8").T_world_imu(t)
    write_tum(tmp_path / "a.tum", 1.7e9 + t, true)
    scene = loads("trajectory: {kind: file, path: a.tum}", base_dir=tmp_path)
    Ts = trajectory.make(scene, 0).T_world_imu(t)
    np.testing.assert_allclose(Ts, true, atol=1e-6)  # 1.7e9 s leave 2e-7 s of a time
    between = trajectory.make(scene, 0).T_world_imu(t[40:160] + 0.025)
    np.testing.assert_allclose(between, make("figure8").T_world_imu(t[40:160] + 0.025), atol=1e-4)


def twist_by_differences(body, t, h=1e-5):
    """The body twist from poses alone, by central differences of T(t)^-1 T(t +- h)."""
    T = np.linalg.inv(body.T_world_imu(t))
    change = (T @ body.T_world_imu(t + h) - T @ body.T_world_imu(t - h)) / (2 * h)
    turning = np.stack([change[:, 2, 1], change[:, 0, 2], change[:, 1, 0]], axis=1)
    return np.hstack([change[:, :3, 3], turning])


@pytest.mark.parametrize("kind", Format)
def test_a_recorded_trajectory_of_every_format_is_a_scene_with_exact_derivatives(tmp_path, kind):
    t = np.arange(0, 10, 0.05)
    true = make("figure8").T_world_imu(t)
    times = tuple(1_403_636_579 + Decimal(i) / 20 for i in range(len(t)))
    write_poses(tmp_path / "a.txt", Poses(times=times, Ts_world_imu=true), kind)
    scene = loads("trajectory: {kind: file, path: a.txt}\nrate_hz: 20", base_dir=tmp_path)
    assert scene.duration_s == pytest.approx(t[-1])
    body = trajectory.make(scene, 0)
    np.testing.assert_allclose(body.T_world_imu(t), true, atol=1e-12)
    between = t[2:-2] + 0.021
    numeric = twist_by_differences(body, between)
    np.testing.assert_allclose(body.twist(between), numeric, rtol=0, atol=1e-8)
    change = (body.twist(between + 1e-5) - body.twist(between - 1e-5)) / 2e-5
    np.testing.assert_allclose(body.acceleration(between), change, rtol=0, atol=1e-6)
    assert loads(scene.to_yaml()) == scene


def test_poses_without_times_are_as_fast_as_the_scene_has_frames(tmp_path):
    write_poses(
        tmp_path / "a.txt",
        Poses(times=None, Ts_world_imu=make("figure8").T_world_imu(np.arange(0, 10, 0.1))),
        Format.KITTI,
    )
    for rate_hz in (5.0, 10.0):
        text = f"trajectory: {{kind: file, path: a.txt}}\nrate_hz: {rate_hz}"
        scene = loads(text, base_dir=tmp_path)
        assert scene.duration_s == pytest.approx(99 / rate_hz)


def test_poses_in_optical_axes_are_turned_to_those_of_the_body(tmp_path):
    """As KITTI has them: z forward, y down. A turn to the right is one about y."""
    angles = np.linspace(0, 1, 11)
    Ts = np.tile(np.eye(4), (11, 1, 1))
    Ts[:, 2, 3] = 2 * angles
    Ts[:, 0, 0] = Ts[:, 2, 2] = np.cos(angles)
    Ts[:, 0, 2], Ts[:, 2, 0] = np.sin(angles), -np.sin(angles)
    write_poses(tmp_path / "a.kitti", Poses(times=None, Ts_world_imu=Ts), Format.KITTI)
    scene = loads("trajectory: {kind: file, path: a.kitti, axes: optical}", base_dir=tmp_path)
    last = trajectory.make(scene, 0).T_world_imu(np.array([1.0]))[0]
    np.testing.assert_allclose(last[:3, 3], [2, 0, 0], atol=1e-12)
    np.testing.assert_allclose(last[:3, 0], [np.cos(1), -np.sin(1), 0], atol=1e-12)
