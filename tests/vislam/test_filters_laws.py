"""What holds of every estimator, whatever the data."""

from dataclasses import replace

import filterpy.kalman
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tests.vislam.drives import drive, feed_together
from vislam.camera import StereoRig
from vislam.filters import DeadReckoning, EkfSlam, Mapping, Parts, slam_invariant
from vislam.filters.model import constant_prior, predictable, whitening
from vislam.filters.observation import Observation
from vislam.filters.records import Correct
from vislam.gaussian import NotPositiveDefinite, covariance_fault
from vislam.lie import se3
from vislam.point import PointSensor
from vislam.types import Belief, Calibration, Noise, PointFrame, StereoFrame, Task

FILTERS = [DeadReckoning, Mapping, Mapping.on_truth, EkfSlam]
schedules = arrays(bool, (6, 5))


@pytest.mark.parametrize("factory", FILTERS)
@given(seen=schedules, seed=st.integers(0, 99), gate=st.sampled_from([None, 0.9]))
@settings(deadline=None, max_examples=15)
def test_covariances_are_covariances_after_every_call(factory, seen, seed, gate):
    d = drive(seen, seed=seed, gate=gate)
    filter_ = factory(d.task)
    for i, frame in enumerate(d.frames):
        if i:
            filter_.predict(*d.twists[i - 1])
            assert covariance_fault(filter_.belief(joint=True).joint_covariance) is None
        filter_.update(frame)
        assert covariance_fault(filter_.belief(joint=True).joint_covariance) is None


@pytest.mark.parametrize("factory", FILTERS)
def test_a_batch_of_runs_equals_the_runs_one_by_one(factory):
    seen = np.random.default_rng(0).random((6, 5)) < 0.7
    runs = [drive(seen, seed=7, noise_scale=scale, gate=0.9) for scale in (0.5, 1.0, 1.5)]
    apart = [factory(d.task) for d in runs]
    for d, filter_ in zip(runs, apart, strict=True):
        d.feed(filter_)

    together = feed_together(factory, runs)
    belief = together.belief(joint=True)
    for k, filter_ in enumerate(apart):
        alone = filter_.belief(joint=True)
        for name in ("T_world_imu", "landmarks", "joint_covariance"):
            expected = getattr(alone, name)
            batched = np.broadcast_to(getattr(belief, name), (3, *expected.shape))
            assert np.allclose(batched[k], expected, rtol=0, atol=1e-12), name


@pytest.mark.parametrize("factory", FILTERS)
def test_a_belief_is_a_snapshot(factory):
    d = drive(np.ones((4, 3), bool))
    filter_ = factory(d.task)
    filter_.update(d.frames[0])
    belief = filter_.belief(joint=True)
    before = [np.copy(a) for a in (belief.T_world_imu, belief.landmarks, belief.joint_covariance)]
    for (twist, dt), frame in zip(d.twists, d.frames[1:], strict=False):
        filter_.predict(twist, dt)
        filter_.update(frame)
    after = [belief.T_world_imu, belief.landmarks, belief.joint_covariance]
    assert all(np.array_equal(a, b) for a, b in zip(before, after, strict=True))


@pytest.mark.parametrize("factory", [Mapping, EkfSlam])
def test_a_frame_of_nothing_but_minus_one_changes_nothing(factory):
    d = drive(np.ones((3, 4), bool))
    filter_ = factory(d.task)
    d.feed(filter_)
    before = filter_.belief(joint=True)
    blank = replace(d.frames[0], pixels=np.full((4, 4), -1.0), last=np.zeros(4, bool))
    innovation = filter_.update(blank)
    after = filter_.belief(joint=True)
    assert np.array_equal(before.joint_covariance, after.joint_covariance)
    assert np.array_equal(before.T_world_imu, after.T_world_imu)
    assert not len(innovation.skipped)


@pytest.mark.parametrize("factory", [Mapping, EkfSlam])
def test_what_is_skipped_is_said(factory):
    d = drive(np.ones((2, 4), bool))
    pixels = d.frames[0].pixels.copy()
    pixels[0, 2:] = -1  # half missing
    pixels[1, 2] = pixels[1, 0] + 1  # behind
    pixels[2] = -1  # not seen at all
    innovation = factory(d.task).update(replace(d.frames[0], pixels=pixels))
    assert innovation.skipped.tolist() == [0, 1]
    assert innovation.born.tolist() == [3]


@pytest.mark.parametrize("factory", [Mapping, EkfSlam])
@given(order=st.permutations(range(5)), seed=st.integers(0, 99))
@settings(deadline=None, max_examples=15)
def test_the_order_of_features_in_a_frame_does_not_matter(factory, order, seed):
    d = drive(np.ones((4, 5), bool), seed=seed)
    one, other = factory(d.task), factory(d.task)
    d.feed(one)
    turned = [
        replace(f, ids=f.ids[order], pixels=f.pixels[order], last=f.last[order]) for f in d.frames
    ]
    replace(d, frames=turned).feed(other)
    a, b = one.finish().final, other.finish().final
    assert np.allclose(a.T_world_imu, b.T_world_imu, rtol=0, atol=1e-11)
    assert np.allclose(a.landmarks, b.landmarks, rtol=0, atol=1e-11)
    assert np.allclose(a.landmark_covariances, b.landmark_covariances, rtol=0, atol=1e-11)


def test_a_landmark_that_falls_behind_the_camera_is_refused():
    d = drive(np.ones((2, 3), bool))
    slam = EkfSlam(d.task)
    slam.update(replace(d.frames[0], last=np.zeros(3, bool)))
    slam.x.T = slam.x.T @ se3.exp(np.array([0, 0, 0, 0, 0, np.pi]))
    before = slam.P.copy()
    innovation = slam.update(replace(d.frames[1], last=np.zeros(3, bool)))
    assert innovation.rejected == 3
    assert np.isnan(innovation.residual).all()
    assert innovation.nis == 0
    assert np.array_equal(slam.P, before)


@pytest.mark.parametrize("factory", [Mapping.on_truth, EkfSlam])
def test_a_landmark_of_wild_depth_beside_the_camera_does_no_harm(factory):
    """Its Jacobian has no bound, so that a gate alone lets it pass and the covariance is lost."""
    d = drive(np.ones((2, 3), bool), gate=0.999)
    beside = np.array([[30.0, 1.0, 0.05]])  # metres in the camera, 5 cm before its plane
    prior = replace(
        d.task.prior,
        ids=np.array([2]),
        landmarks=se3.apply(d.T_world_imu[0] @ d.task.calibration.T_imu_cam, beside),
        landmark_covariances=np.stack([200.0**2 * np.eye(3)]),
    )
    filter_ = factory(replace(d.task, prior=prior))
    innovation = filter_.update(d.frames[0])
    assert innovation.ids.tolist() == [2]
    assert innovation.rejected == 1
    filter_.predict(*d.twists[0])
    filter_.update(replace(d.frames[1], last=np.zeros(3, bool)))
    assert covariance_fault(filter_.belief(joint=True).joint_covariance) is None


def test_retired_landmarks_leave_the_state_and_stay_in_the_final_map():
    seen = np.array([[1, 1, 0], [1, 1, 0], [0, 1, 1], [0, 0, 1]], bool)
    d = drive(seen)
    slam = EkfSlam(d.task)
    d.feed(slam)
    assert slam.belief().ids.tolist() == []
    assert slam.P.shape == (6, 6)
    assert slam.finish().final.ids.tolist() == [0, 1, 2]


@given(seed=st.integers(0, 999), k=st.integers(1, 4), spare=st.integers(0, 2))
@settings(deadline=None, max_examples=30)
def test_an_update_is_filterpys_on_a_linear_problem(seed, k, spare):
    rng = np.random.default_rng(seed)
    m = k + spare
    n = 6 + 3 * m
    root = rng.standard_normal((n, n))
    P = root @ root.T
    slots = rng.permutation(m)[:k]
    H_pose, H_map = rng.standard_normal((k, 3, 6)), rng.standard_normal((k, 3, 3))
    r = rng.standard_normal((k, 3))
    observation = Observation(slots=slots, H_pose=H_pose, H_map=H_map, r=r)
    correction = Correct.of(observation, P)

    judge = filterpy.kalman.KalmanFilter(dim_x=n, dim_z=3 * k)
    judge.P, judge.R = P.copy(), np.eye(3 * k)
    judge.H = np.zeros((3 * k, n))
    for i, slot in enumerate(slots):
        judge.H[3 * i : 3 * i + 3, :6] = H_pose[i]
        judge.H[3 * i : 3 * i + 3, 6 + 3 * slot : 9 + 3 * slot] = H_map[i]
    judge.update(r.reshape(-1, 1))
    assert np.allclose(correction.delta, judge.x[:, 0], atol=1e-9)
    assert np.allclose(correction.forward(P), judge.P, atol=1e-8)
    nis = judge.mahalanobis**2
    assert np.square(correction.whitened).sum() == pytest.approx(nis, rel=1e-8)

    each = [slice(3 * i, 3 * i + 3) for i in range(k)]
    S_each = observation.innovation_covariance_of_each(P)
    assert np.allclose(S_each, [judge.S[rows, rows] for rows in each], rtol=1e-12)
    distances = [r[i] @ np.linalg.inv(judge.S[rows, rows]) @ r[i] for i, rows in enumerate(each)]
    assert np.allclose(observation.distances(S_each), distances, rtol=1e-9)
    assert (observation.variance_bounds(P).ravel() >= np.diagonal(judge.S)).all()
    assert (observation.variance_bounds(0 * P) == 1).all()


def test_the_papers_start_claims_too_much_and_says_so_nowhere():
    d = drive(np.ones((1, 3), bool))
    claimed = EkfSlam(d.task, Parts(birth=constant_prior))
    honest = EkfSlam(d.task)
    keep = replace(d.frames[0], last=np.zeros(3, bool))
    claimed.update(keep)
    honest.update(keep)
    assert np.array_equal(claimed.belief().landmarks, honest.belief().landmarks)
    assert not claimed.P[:6, 6:].any()
    assert honest.P[:6, 6:].any()
    assert np.array_equal(claimed.belief().landmark_covariances, [np.eye(3)] * 3)


def test_a_prior_that_is_no_covariance_is_named_at_the_update_that_it_breaks():
    d = drive(np.ones((1, 3), bool))
    prior = replace(
        d.task.prior,
        ids=np.arange(3),
        landmarks=d.landmarks,
        landmark_covariances=np.stack([-np.eye(3)] * 3),
    )
    with pytest.raises(NotPositiveDefinite, match="check the prior"):
        EkfSlam(replace(d.task, prior=prior)).update(d.frames[0])


def test_mapping_on_the_truth_needs_the_truth():
    d = drive(np.ones((1, 3), bool))
    with pytest.raises(ValueError, match="data do not know it"):
        Mapping.on_truth(replace(d.task, trajectory=None))


def test_a_noise_that_is_none_is_refused():
    with pytest.raises(ValueError, match="four positive `sigma_px`"):
        Noise(process_model="twist", process=np.eye(6), sigma_px=np.zeros(4))
    with pytest.raises(ValueError, match="one of"):
        Noise(process_model="white", process=np.eye(6), sigma_px=np.ones(4))


@pytest.mark.parametrize(
    ("P", "fault"),
    [
        (np.eye(3), None),
        (np.zeros((3, 3)), None),
        (np.diag([1.0, 0.0, -1e-14]), None),
        (np.diag([1.0, 1.0, -1e-6]), "smallest eigenvalue"),
        (np.array([[1.0, 1e-6], [0.0, 1.0]]), "asymmetric"),
        (np.array([[np.nan]]), "not finite"),
    ],
)
def test_what_is_no_covariance_is_told_why(P, fault):
    found = covariance_fault(P)
    assert found is None if fault is None else fault in found


@pytest.mark.parametrize("cx_px", [0.0, 620.0])
def test_a_rig_without_an_image_size_is_used_wherever_its_centre_lies(cx_px):
    rig = StereoRig(fx_px=552, fy_px=540, cx_px=cx_px, cy_px=0, baseline_m=0.6)
    calibration = Calibration(rig=rig, T_imu_cam=np.eye(4))
    pixels = np.array([[cx_px + 10.0, 5.0, cx_px - 20.0, 5.0]])
    frame = StereoFrame(time_s=0.0, ids=np.array([0]), pixels=pixels, last=np.array([False]))
    task = replace(drive(np.ones((1, 1), bool)).task, calibration=calibration)
    slam = EkfSlam(task)
    slam.update(frame)
    assert slam.update(frame).accepted.all()


def test_a_sigma_of_the_prediction_is_in_pixels():
    noise = Noise(process_model="twist", process=np.eye(6), sigma_px=np.array([0.7, 0.9, 1.2, 0.5]))
    whole = whitening(noise, np.empty((1, 4)))
    W = whole[:3]
    for sigma_px in (1241.0, 1243.0):  # of all coordinates at once; the image is 1242 wide
        S = W @ (sigma_px**2 * np.ones((4, 4))) @ W.T
        told = drive(np.ones((1, 1), bool)).task.calibration
        within = predictable(told, whole, np.diagonal(S)[None])
        assert within.tolist() == [sigma_px < 1242]


@pytest.mark.parametrize("kind", [np.int64, np.float32])
def test_a_prior_of_other_numbers_is_one_of_floats(kind):
    """np.diag([1, 1, 1, 1, 1, 1]) is a natural way to say it."""
    d = drive(np.ones((2, 3), bool))
    for factory in (EkfSlam, slam_invariant):
        covariances = []
        for number in (float, kind):
            prior = replace(d.task.prior, pose_covariance=np.eye(6, dtype=number))
            filter_ = factory(replace(d.task, prior=prior))
            filter_.predict(*d.twists[0])
            covariances.append(filter_.belief().pose_covariance)
        np.testing.assert_allclose(covariances[1], covariances[0], rtol=1e-12)


def test_each_sighting_in_doubt_is_judged_by_its_own_noise():
    """The second landmark is a hundred times nearer, its place unsure by 5 m of the range of 20."""
    points = np.array([[10.0, 0, 0], [0.1, 0, 0]])
    task = Task(
        calibration=Calibration(rig=PointSensor(range_m=(0.0, 20.0)), T_imu_cam=np.eye(4)),
        noise=Noise(process_model="twist", process=np.eye(6), point_share=0.02, point_floor_m=1e-4),
        prior=Belief(
            T_world_imu=np.eye(4),
            pose_covariance=np.zeros((6, 6)),
            ids=np.arange(2),
            landmarks=points,
            landmark_covariances=np.stack([1e-6 * np.eye(3), 25.0 * np.eye(3)]),
        ),
        gate=0.99,
    )
    seen = points + np.array([[0.0, 0, 0], [1.0, 0, 0]])
    frame = PointFrame(time_s=0.0, ids=np.arange(2), points=seen, last=np.zeros(2, bool))
    assert EkfSlam(task).update(frame).accepted.tolist() == [True, True]
