import json

import filterpy.stats
import numpy as np
import pytest
from evo.core import metrics as evo_metrics
from evo.core import trajectory as evo_trajectory
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from scipy.spatial.transform import Rotation

from simbench.errors import InputError
from simbench.metrics import (
    align,
    ate,
    chi_square_band,
    landmark_errors,
    metrics,
    nees,
    nis,
    path_length,
    pose_nees,
    rmse,
    rpe,
    whiteness,
)
from tests.simbench.records import circle, draw, spread, without
from vislam.types import Innovation

seeds = st.integers(0, 2**32 - 1)

NAMES = [
    "source",
    "filter",
    "frames",
    "landmarks",
    "duration_s",
    "wall_s",
    "realtime_factor",
    "path_length_m",
    "ate_rmse_m",
    "ate_rmse_aligned_m",
    "rpe_trans_rmse_m",
    "rpe_rot_rmse_deg",
    "final_position_error_m",
    "final_rotation_error_deg",
    "pose_nees_mean",
    "landmark_nees_mean",
    "landmark_rmse_m",
    "nis_mean_per_dof",
    "accepted",
    "rejected",
    "skipped_features",
    "rejected_share",
    "noise_fit",
]
SMOOTHED = [f"smoothed_{name}" for name in NAMES[8:15]]


def poses(rng, count, sigma_m=5.0):
    T = np.zeros((count, 4, 4))
    T[:, :3, :3] = Rotation.random(count, rng).as_matrix()
    T[:, :3, 3] = sigma_m * rng.standard_normal((count, 3))
    T[:, 3, 3] = 1
    return T


def disturbed(rng, T):
    """Poses near to T."""
    near = T.copy()
    near[:, :3, :3] = (
        T[:, :3, :3] @ Rotation.from_rotvec(0.1 * rng.standard_normal((len(T), 3))).as_matrix()
    )
    near[:, :3, 3] += 0.3 * rng.standard_normal((len(T), 3))
    return near


def yaw_turn(angle, translation):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("z", angle).as_matrix()
    T[:3, 3] = translation
    return T


# ---- trajectories, against evo


def evo_errors(metric, true, estimated):
    metric.process_data(
        tuple(evo_trajectory.PosePath3D(poses_se3=list(T)) for T in (true, estimated))
    )
    return metric.error


def relations():
    return evo_metrics.PoseRelation.translation_part, evo_metrics.PoseRelation.rotation_angle_rad


@pytest.mark.parametrize("seed", range(3))
def test_absolute_errors_equal_those_of_evo(seed):
    rng = np.random.default_rng(seed)
    true = poses(rng, 200)
    estimated = disturbed(rng, true)
    ours = ate(estimated, true)
    translation, rotation = (evo_errors(evo_metrics.APE(r), true, estimated) for r in relations())
    np.testing.assert_allclose(ours.translation_m, translation, rtol=0, atol=1e-9)
    np.testing.assert_allclose(ours.rotation_rad, rotation, rtol=0, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_aligned_absolute_errors_equal_those_of_evo(seed):
    rng = np.random.default_rng(seed)
    true = poses(rng, 200)
    estimated = poses(rng, 1)[0] @ disturbed(rng, true)
    ours = ate(estimated, true, "se3")
    theirs = evo_trajectory.PosePath3D(poses_se3=list(estimated))
    theirs.align(evo_trajectory.PosePath3D(poses_se3=list(true)))
    for relation, error in zip(relations(), (ours.translation_m, ours.rotation_rad), strict=True):
        expected = evo_errors(evo_metrics.APE(relation), true, theirs.poses_se3)
        np.testing.assert_allclose(error, expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("step", [1, 7])
def test_relative_errors_equal_those_of_evo(step):
    rng = np.random.default_rng(step)
    true = poses(rng, 150)
    estimated = disturbed(rng, true)
    ours = rpe(estimated, true, step)
    for relation, error in zip(relations(), (ours.translation_m, ours.rotation_rad), strict=True):
        metric = evo_metrics.RPE(relation, delta=step, all_pairs=True)
        expected = evo_errors(metric, true, estimated)
        np.testing.assert_allclose(error, expected, rtol=0, atol=1e-9)


def test_metrics_of_a_run_equal_those_of_evo():
    record = circle().record
    true, estimated = record.dataset.truth.T_world_imu, record.T_world_imu
    values = metrics(record)
    translation = evo_metrics.PoseRelation.translation_part
    degrees = evo_metrics.PoseRelation.rotation_angle_deg
    absolute = evo_errors(evo_metrics.APE(translation), true, estimated)
    aligned = evo_trajectory.PosePath3D(poses_se3=list(estimated))
    aligned.align(evo_trajectory.PosePath3D(poses_se3=list(true)))
    for name, expected in {
        "ate_rmse_aligned_m": rmse(
            evo_errors(evo_metrics.APE(translation), true, aligned.poses_se3)
        ),
        "ate_rmse_m": np.sqrt(np.mean(absolute**2)),
        "final_position_error_m": absolute[-1],
        "final_rotation_error_deg": evo_errors(evo_metrics.APE(degrees), true, estimated)[-1],
        "rpe_trans_rmse_m": rmse(
            evo_errors(evo_metrics.RPE(translation, delta=1), true, estimated)
        ),
        "rpe_rot_rmse_deg": rmse(evo_errors(evo_metrics.RPE(degrees, delta=1), true, estimated)),
        "path_length_m": evo_trajectory.PosePath3D(poses_se3=list(true)).path_length,
    }.items():
        assert values[name] == pytest.approx(expected, abs=1e-9), name


# ---- alignment


@given(seeds)
def test_a_moved_copy_has_no_error_once_it_is_aligned(seed):
    rng = np.random.default_rng(seed)
    true, motion = poses(rng, 20), poses(rng, 1)[0]
    errors = ate(motion @ true, true, "se3")
    assert errors.translation_m.max() < 1e-11
    assert errors.rotation_rad.max() < 1e-11


@given(seeds)
def test_aligned_errors_do_not_change_when_the_estimate_is_moved(seed):
    rng = np.random.default_rng(seed)
    true = poses(rng, 20)
    estimated, motion = disturbed(rng, true), poses(rng, 1)[0]
    before, after = (ate(T, true, "se3") for T in (estimated, motion @ estimated))
    np.testing.assert_allclose(after.translation_m, before.translation_m, atol=1e-10)


@given(seeds, st.floats(-np.pi, np.pi))
def test_yaw_alignment_undoes_a_turn_about_the_vertical(seed, angle):
    rng = np.random.default_rng(seed)
    true = poses(rng, 20)
    motion = yaw_turn(angle, rng.standard_normal(3))
    assert ate(motion @ true, true, "yaw").translation_m.max() < 1e-11


@given(seeds)
def test_yaw_alignment_is_the_best_turn_about_the_vertical(seed):
    rng = np.random.default_rng(seed)
    true, estimated = poses(rng, 12), poses(rng, 12)
    best = align(estimated[:, :3, 3], true[:, :3, 3], "yaw")
    np.testing.assert_allclose(best[2, :3], [0, 0, 1], atol=1e-15)
    least = rmse(ate(best @ estimated, true).translation_m)
    for angle in np.linspace(0, 2 * np.pi, 25):
        other = yaw_turn(angle, 0)
        other[:3, 3] = true[:, :3, 3].mean(0) - other[:3, :3] @ estimated[:, :3, 3].mean(0)
        assert least <= rmse(ate(other @ estimated, true).translation_m) + 1e-12


def test_alignments_with_more_freedom_leave_less_error():
    rng = np.random.default_rng(0)
    true, estimated = poses(rng, 30), poses(rng, 30)
    none, yaw, se3 = (
        rmse(ate(estimated, true, how).translation_m) for how in ("none", "yaw", "se3")
    )
    assert se3 < yaw < none


@pytest.mark.parametrize("how", ["yaw", "se3"])
@pytest.mark.parametrize("direction", [[0, 0, 0], [1, 0, 0], [0, 0, 1]])
def test_alignment_takes_a_robot_at_rest_and_one_on_a_straight_line(direction, how):
    true = np.tile(np.eye(4), (9, 1, 1))
    true[:, :3, 3] = np.outer(np.arange(9), direction)
    assert ate(yaw_turn(0.3, [1, 2, 3]) @ true, true, how).translation_m.max() < 1e-12


def test_the_mirror_image_of_a_path_is_no_moved_copy():
    true = poses(np.random.default_rng(0), 30)
    mirrored = true.copy()
    mirrored[:, 1, 3] *= -1
    assert rmse(ate(mirrored, true, "se3").translation_m) > 1
    T = align(mirrored[:, :3, 3], true[:, :3, 3], "se3")
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1)


def test_equal_trajectories_have_no_error():
    true = poses(np.random.default_rng(0), 10)
    for errors in (ate(true, true), rpe(true, true)):
        assert errors.translation_m.max() < 1e-13
        assert (
            errors.rotation_rad.max() < 1e-7
        )  # no more can be read from a matrix near the identity


def test_a_square_of_one_metre_is_four_metres_long():
    T = np.tile(np.eye(4), (5, 1, 1))
    T[:, :2, 3] = [[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]]
    assert path_length(T) == 4


def test_trajectories_of_different_length_are_refused():
    T = poses(np.random.default_rng(0), 5)
    with pytest.raises(
        InputError, match=r"shape \(T, 4, 4\) both, got \(4, 4, 4\) and \(5, 4, 4\)"
    ):
        ate(T[:4], T)
    with pytest.raises(InputError, match="at least 1 frame, got 0"):
        rpe(T, T, 0)
    with pytest.raises(InputError, match=r"'none', 'yaw', 'se3'.* got 'sim3'"):
        ate(T, T, "sim3")


# ---- NEES


def test_nees_equals_that_of_filterpy_in_a_euclidean_case():
    rng = np.random.default_rng(0)
    P = spread(rng, 4, (50,))
    true, estimated = rng.standard_normal((2, 50, 4))
    expected = filterpy.stats.NEES(true, estimated, P)
    np.testing.assert_allclose(nees(true - estimated, P), expected, rtol=1e-9)


@given(seeds, st.integers(1, 8))
def test_nees_does_not_depend_on_the_coordinates(seed, n):
    rng = np.random.default_rng(seed)
    P, e = spread(rng, n, (5,)), rng.standard_normal((5, n))
    A = (
        Rotation.random(rng=rng).as_matrix()
        if n == 3
        else np.linalg.qr(rng.standard_normal((n, n)))[0]
    )
    A = np.logspace(-6, 6, n)[:, None] * A  # other units
    np.testing.assert_allclose(nees(e @ A.T, A @ P @ A.T), nees(e, P), rtol=1e-7)


@given(seeds, st.integers(1, 5))
def test_nees_keeps_to_the_directions_that_vary(seed, rank):
    rng = np.random.default_rng(seed)
    basis = np.linalg.qr(rng.standard_normal((6, 6)))[0]
    inner, e = spread(rng, rank, ()), rng.standard_normal(rank)
    U, lost = basis[:, :rank], basis[:, rank]
    P = U @ inner @ U.T
    np.testing.assert_allclose(nees(U @ e, P), e @ np.linalg.solve(inner, e), rtol=1e-8)
    assert nees(U @ e + 1e-3 * lost, P) == np.inf


def test_nees_of_an_exactly_known_state_is_zero_or_infinite():
    known = np.zeros((6, 6))
    assert nees(np.zeros(6), known) == 0
    assert nees([0, 0, 0, 0, 0, 1e-3], known) == np.inf


@pytest.mark.parametrize("fault", [-1e-3, np.nan, np.inf])
def test_nees_of_what_is_no_covariance_is_infinite_and_spares_its_neighbours(fault):
    P = np.tile(np.eye(3), (2, 1, 1))
    P[0, 1, 1] = fault
    np.testing.assert_array_equal(nees(np.ones((2, 3)), P), [np.inf, 3])
    assert nees([1, np.nan], np.eye(2)) == np.inf


def test_nees_of_an_indefinite_matrix_with_positive_variances_is_infinite():
    assert nees([1.0, 1.0], [[1, 2], [2, 1]]) == np.inf


def test_nees_refuses_shapes_that_do_not_match():
    with pytest.raises(
        InputError, match=r"\(\.\.\., 3, 3\) for an `error` of \(3,\), got \(6, 6\)"
    ):
        nees(np.zeros(3), np.eye(6))


@pytest.mark.parametrize("n", [1, 3, 6])
def test_mean_nees_of_errors_drawn_from_their_covariance_lies_in_its_band(n):
    """N = 4000 draws, two-sided, false alarm 1e-4 each."""
    rng = np.random.default_rng(n)
    P = spread(rng, n, (4000,))
    low, high = chi_square_band(n, 1 - 1e-4, 4000)
    assert low < nees(draw(rng, P), P).mean() < high
    assert not low < nees(1.1 * draw(rng, P), P).mean() < high


# ---- bands


@given(st.integers(1, 600), st.integers(1, 200), st.floats(0.01, 1 - 1e-9))
def test_a_band_holds_its_probability_with_equal_tails(dof, count, probability):
    low, high = chi_square_band(dof, probability, count)
    tail = (1 - probability) / 2
    assert stats.chi2.cdf(low * count, dof * count) == pytest.approx(tail, rel=1e-6)
    assert stats.chi2.sf(high * count, dof * count) == pytest.approx(tail, rel=1e-6)


@pytest.mark.parametrize(
    ("runs", "probability", "low", "high"),
    [
        (20, 0.95, 0.763, 1.268),
        (50, 0.95, 0.846, 1.166),
        (100, 0.95, 0.890, 1.116),
        (20, 0.999, 0.629, 1.480),
    ],
)
def test_bands_of_pose_nees_are_those_of_the_literature(runs, probability, low, high):
    band = np.array(chi_square_band(6, probability, runs)) / 6
    np.testing.assert_allclose(band, [low, high], atol=6e-4)


def test_a_band_takes_degrees_of_freedom_by_frame():
    low, high = chi_square_band([4, 8], 0.95)
    np.testing.assert_allclose(low, stats.chi2.ppf(0.025, [4, 8]))
    np.testing.assert_allclose(high, stats.chi2.ppf(0.975, [4, 8]))


@pytest.mark.parametrize("probability", [0, 1, 95])
def test_a_band_refuses_what_is_no_probability(probability):
    with pytest.raises(InputError, match=f"between 0 and 1, got {probability}"):
        chi_square_band(6, probability)


# ---- whiteness


def innovation(whitened, ids=None, accepted=None):
    n = len(whitened)
    return Innovation(
        ids=np.arange(n) if ids is None else np.asarray(ids),
        residual=whitened,
        whitened=whitened,
        accepted=np.ones(n, bool) if accepted is None else np.asarray(accepted),
    )


def test_whiteness_is_the_textbook_ljung_box_on_a_series_without_gaps():
    rng = np.random.default_rng(0)
    x = rng.standard_normal(50)
    # one landmark whose four numbers are the same series: all sums are four times the textbook's
    white = whiteness([innovation(np.full((1, 4), v)) for v in x], lags=3)
    n, power = 4 * len(x), np.sum(x**2)
    r = [np.sum(x[k:] * x[:-k]) / power for k in (1, 2, 3)]
    np.testing.assert_allclose(
        white.autocorrelation, [v * 50 / (50 - k) for k, v in enumerate(r, 1)], rtol=1e-12
    )
    expected = n * (n + 2) * sum(v**2 / (n - 4 * k) for k, v in enumerate(r, 1))
    assert white.statistic == pytest.approx(expected, rel=1e-12)
    assert white.dof == 3
    assert white.p == pytest.approx(stats.chi2.sf(expected, 3), rel=1e-9)


def test_whiteness_pairs_a_landmark_only_with_itself_and_only_where_accepted():
    w = np.arange(8.0).reshape(2, 4) + 1
    frames = [
        innovation(w, [3, 7]),
        None,
        innovation(w[:1], [7]),
        innovation(w, [3, 7], [False, True]),
    ]
    white = whiteness(frames, lags=3)
    np.testing.assert_array_equal(white.pairs, [4, 4, 4])  # 7 at (2, 3), at (0, 2), at (0, 3)
    power = (2 * np.sum(w[1] ** 2) + 2 * np.sum(w[0] ** 2)) / 16
    products = [np.sum(w[0] * w[1]), np.sum(w[0] * w[1]), np.sum(w[1] * w[1])]
    np.testing.assert_allclose(white.autocorrelation, np.array(products) / 4 / power)


def test_p_of_white_innovations_is_uniform_and_of_coloured_ones_small():
    """300 runs of 30 frames with 8 landmarks; Kolmogorov-Smirnov, false alarm 1e-3."""
    rng = np.random.default_rng(0)
    w = rng.standard_normal((300, 30, 8, 4))
    p = [whiteness([innovation(f) for f in frames], lags=4).p for frames in w]
    assert stats.kstest(p, "uniform").pvalue > 1e-3
    coloured = w[0, 1:] + 0.5 * w[0, :-1]
    white = whiteness([innovation(f) for f in coloured])
    assert white.p < 1e-6
    assert white.autocorrelation[0] == pytest.approx(0.4, abs=0.1)  # 0.5 / (1 + 0.5^2)


def test_whiteness_of_nothing_is_undefined():
    white = whiteness([None, None], lags=2)
    assert (white.dof, white.pairs.tolist()) == (0, [0, 0])
    assert np.isnan(white.p)
    assert np.isnan(white.autocorrelation).all()


# ---- of a run


def test_metrics_hold_the_numbers_that_were_planted():
    planted = circle(frames=50, landmarks=30)
    values = metrics(planted.record)
    e, P = planted.pose_error[1:], planted.pose_covariance[1:]  # the start is known exactly
    expected = np.mean([x @ np.linalg.solve(C, x) for x, C in zip(e, P, strict=True)])
    assert values["pose_nees_mean"] == pytest.approx(expected, rel=1e-8)
    f, P = planted.landmark_error, planted.landmark_covariance
    expected = np.mean([x @ np.linalg.solve(C, x) for x, C in zip(f, P, strict=True)])
    assert values["landmark_nees_mean"] == pytest.approx(expected, rel=1e-9)
    assert values["landmark_rmse_m"] == pytest.approx(np.sqrt((f**2).sum(1).mean()), rel=1e-9)
    innovations = [s.innovation for s in planted.record.steps[1:]]
    accepted = sum(i.accepted.sum() for i in innovations)
    total = sum((i.whitened**2).sum() for i in innovations)
    assert values["nis_mean_per_dof"] == pytest.approx(total / (4 * accepted), rel=1e-12)
    assert values["accepted"] == accepted
    assert values["rejected"] == 49 * 15 - accepted
    assert values["skipped_features"] == 49
    assert (values["source"], values["filter"]) == ("circle", "slam")
    assert (values["frames"], values["landmarks"]) == (50, 15)
    assert values["duration_s"] == pytest.approx(4.9)
    assert values["realtime_factor"] == pytest.approx(4.9 / 0.5)


@pytest.mark.parametrize("truth", [False, True])
@pytest.mark.parametrize("covariance", [False, True])
@pytest.mark.parametrize("innovations", [False, True])
@pytest.mark.parametrize("frames", [1, 2, 9])
def test_metrics_always_hold_every_name_and_plain_json(frames, innovations, covariance, truth):
    planted = circle(frames=frames)
    values = metrics(without(planted, truth=truth, covariance=covariance, innovations=innovations))
    assert list(values) == NAMES + SMOOTHED
    assert {type(v) for v in values.values()} <= {str, int, float, type(None)}
    assert json.loads(json.dumps(values, allow_nan=False)) == values


def test_what_a_run_cannot_know_is_null():
    planted = circle()
    always = set(NAMES) - {n for n, v in metrics(without(planted, truth=True)).items() if v is None}
    assert always == {
        *("source", "filter", "frames", "landmarks", "duration_s", "wall_s", "realtime_factor"),
        *("path_length_m", "nis_mean_per_dof", "accepted", "rejected", "skipped_features"),
        *("rejected_share", "noise_fit"),
    }

    def null(record):
        found = {name for name, value in metrics(record).items() if value is None}
        assert found >= set(SMOOTHED)  # nobody asked for them
        return found - set(SMOOTHED)

    assert null(planted.record) == set()
    assert null(without(planted, covariance=True)) == {"pose_nees_mean", "landmark_nees_mean"}
    assert null(without(planted, innovations=True)) == {
        "nis_mean_per_dof",
        "accepted",
        "rejected",
        "skipped_features",
        "rejected_share",
        "noise_fit",
    }


def test_a_broken_covariance_makes_the_mean_null_and_is_not_left_out():
    planted = circle(frames=5)
    planted.record.steps[3].belief.pose_covariance[0, 0] = -1
    assert metrics(planted.record)["pose_nees_mean"] is None


def test_pose_nees_by_frame_is_undefined_where_the_pose_is_known():
    values = pose_nees(circle(frames=20).record)
    assert np.isnan(values).tolist() == [True] + [False] * 19


def test_a_landmark_that_the_truth_does_not_know_is_left_out():
    planted = circle(landmarks=10)
    planted.record.final.ids[-1] = 99
    errors = landmark_errors(planted.record)
    assert errors.ids.tolist() == [0, 2, 4, 6]
    np.testing.assert_allclose(errors.error_m, planted.landmark_error[:4], atol=1e-12)


def test_nis_by_frame_is_zero_of_zero_without_an_innovation():
    value, dof = nis(circle(frames=3).record)
    assert (value[0], dof[0]) == (0, 0)
    assert dof[1] > 0
