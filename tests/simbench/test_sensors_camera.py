"""What the cameras report, against the truth projected by others."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from simbench.sensors import simulate
from simbench.sensors.camera import camera_matrices, hidden, projected
from tests.simbench.scenes import RICH, scene
from vislam import camera as vislam_camera
from vislam.camera import StereoRig
from vislam.lie import se3


def of_frame(data) -> np.ndarray:
    """The frame of each sighting."""
    return data.sightings.frames


def true_pixels(data) -> np.ndarray:
    """The sightings as the truth has them, by vislam's projection."""
    T_world_cam = data.truth.T_world_imu @ data.truth.calibration.T_imu_cam
    points = data.truth.landmarks[data.sightings.ids]
    T_cam_world = se3.inverse(T_world_cam)[of_frame(data)]
    p_cam = np.einsum("nij,nj->ni", T_cam_world[:, :3, :3], points) + T_cam_world[:, :3, 3]
    return vislam_camera.project(data.truth.calibration.rig, p_cam)


def pixels_by_sighting(data) -> dict:
    """Pixels by (frame, landmark), as bytes."""
    keys = zip(of_frame(data).tolist(), data.sightings.ids.tolist(), strict=True)
    return dict(zip(keys, (row.tobytes() for row in data.sightings.pixels), strict=True))


numbers = st.floats(-1, 1)


@given(
    points=arrays(float, (7, 3), elements=numbers),
    lens=st.tuples(*[st.floats(100, 2000)] * 2, *[st.floats(0, 1000)] * 2, st.floats(0.01, 2)),
    lever=st.tuples(*[numbers] * 3),
    turn=st.tuples(*[st.floats(-170, 170)] * 3),
)
def test_both_projections_agree(points, lens, lever, turn):
    """Points 0.5 to 50 m ahead of the camera; they agree to 1e-12 of the largest intermediate."""
    fx, fy, cx, cy, b = lens
    rig = {"fx_px": fx, "fy_px": fy, "cx_px": cx, "cy_px": cy, "baseline_m": b}
    a_scene = scene(rig=rig | {"imu_cam": {"translation_m": lever, "rotvec_deg": turn}})
    p_cam = points * [20, 20, 24.75] + [0, 0, 25.25]
    p_imu = se3.apply(a_scene.rig.T_imu_cam, p_cam)
    ours, depth = projected(camera_matrices(a_scene.rig, a_scene.rig.T_imu_cam), p_imu)
    theirs = vislam_camera.project(StereoRig(**rig), p_cam)
    scale = (max(fx, fy) * 22 + 1000 * 50) / p_cam[:, 2:]
    assert (np.abs(ours - theirs) <= 1e-12 * scale).all()
    np.testing.assert_allclose(depth, p_cam[:, 2], rtol=0, atol=1e-12 * 60)


def clear_of_borders(data, margin_px):
    """Which sightings stay usable however each coordinate moves by up to the margin."""
    exact = true_pixels(data)
    inside = (exact > margin_px) & (exact < np.tile([1241, 375], 2) - margin_px)
    return inside.all(axis=1) & (exact[:, 0] - exact[:, 2] > 1 + 2 * margin_px)


def residuals(seeds):
    """(measured - true) / sigma of sightings that no noise could have lost, ids, frames."""
    a_scene = scene(camera={"sigma_px": [0.4, 0.7, 1.0, 1.3]})
    for seed in seeds:
        data = simulate(a_scene, seed)
        safe = clear_of_borders(data, 7 * 1.3)
        z = (data.sightings.pixels - true_pixels(data)) / a_scene.camera.sigma_px
        yield z[safe], data.sightings.ids[safe], of_frame(data)[safe]


def test_pixel_noise_has_the_sigma_of_each_coordinate_zero_mean_and_no_correlation():
    """5 seeds, about 4,000 sightings; 18 two-sided statistics, 1 false alarm in 1,000 for all."""
    from scipy.stats import chi2, norm

    parts = list(residuals(range(5)))
    z = np.concatenate([part[0] for part in parts])
    n, alpha = len(z), 1e-3 / 18
    assert n > 2000
    assert np.abs(z.mean(axis=0) * np.sqrt(n)).max() < norm.isf(alpha / 2)
    low, high = chi2.ppf([alpha / 2, 1 - alpha / 2], n)
    assert ((low < np.square(z).sum(axis=0)) & (np.square(z).sum(axis=0) < high)).all()
    r = np.corrcoef(z.T)[np.triu_indices(4, 1)]
    assert np.abs(np.arctanh(r)).max() * np.sqrt(n - 3) < norm.isf(alpha / 2)
    # and none from one frame to the next, on the same landmark
    products = []
    for part, ids, frames in parts:
        order = np.lexsort((frames, ids))
        next_ = (np.diff(ids[order]) == 0) & (np.diff(frames[order]) == 1)
        products.append((part[order][:-1] * part[order][1:])[next_])
    lagged = np.concatenate(products)
    assert np.abs(lagged.mean(axis=0)).max() * np.sqrt(len(lagged)) < norm.isf(alpha / 2)


def test_what_is_reported_is_visible_in_the_truth_and_usable_as_it_stands():
    data = simulate(scene(camera={"sigma_px": 2.0}))
    pixels, exact = data.sightings.pixels, true_pixels(data)
    for z in (pixels, exact):
        assert (z > 0).all()  # on the very border stands only what was clipped to it
        assert (z < np.tile([1241, 375], 2)).all()
    rig = data.truth.calibration.rig
    depth = vislam_camera.triangulate(rig, exact)[:, 2]
    assert ((depth >= 1 - 1e-9) & (depth <= 12 + 1e-9)).all()
    assert (pixels[:, 0] - pixels[:, 2] >= 1).all()


def test_without_chance_everything_visible_is_reported():
    """By brute force over all landmarks; what lies within 4 sigma of a border may differ."""
    data = simulate(scene(camera={"sigma_px": 1e-6}))
    rig, T_imu_cam = data.truth.calibration.rig, data.truth.calibration.T_imu_cam
    for i in range(0, len(data), 7):
        p = se3.apply(se3.inverse(data.truth.T_world_imu[i] @ T_imu_cam), data.truth.landmarks)
        expected = [
            j
            for j, q in enumerate(p)
            if 1 <= q[2] <= 12
            and ((z := vislam_camera.project(rig, q[None])[0]) >= 0).all()
            and z[[0, 2]].max() <= 1241
            and z[[1, 3]].max() <= 375
        ]
        assert data.frame(i).ids.tolist() == expected


coordinates = st.integers(-8, 8).map(lambda i: i / 2 + 0.13)


@given(
    walls=st.lists(
        st.tuples(coordinates, coordinates, coordinates, coordinates, st.floats(0.1, 5)),
        min_size=1,
        max_size=4,
    ),
    eye=st.tuples(*[st.integers(-8, 8)] * 3),
    points=arrays(float, (5, 3), elements=st.integers(-8, 8).map(float)),
)
def test_a_wall_hides_what_a_linear_system_says_is_behind_it(walls, eye, points):
    """eye + r (m - eye) = foot + s along + h up, solved for (r, s, h) one by one."""
    walls, eye = np.array(walls), np.array(eye, float)
    got = hidden(walls, eye, points)
    for j, m in enumerate(points):
        doubtful, behind = False, False
        for x0, y0, x1, y1, height in walls:
            A = np.column_stack([m - eye, [x0 - x1, y0 - y1, 0], [0, 0, -1]])
            if abs(np.linalg.det(A)) < 1e-9:
                continue
            r, s, h = np.linalg.solve(A, [x0 - eye[0], y0 - eye[1], -eye[2]])
            gaps = np.array([r, 1 - r, s, 1 - s, h, height - h])
            doubtful |= np.abs(gaps).min() < 1e-6
            behind |= (gaps > 0).all()
        assert doubtful or got[j] == behind


def test_a_landmark_on_a_wall_is_seen_and_one_behind_it_is_not():
    wall = np.array([[5.0, -3.0, 5.0, 3.0, 2.0]])
    points = np.array([[5.0, 1.0, 1.0], [5.1, 1.0, 1.0], [5.1, 1.0, 4.0], [4.9, 1.0, 1.0]])
    assert hidden(wall, np.array([0.0, 0.0, 1.0]), points).tolist() == [False, True, False, False]


@pytest.mark.parametrize(
    ("y", "z", "seen"),
    [
        *[(-3.1, 1, True), (-2.9, 1, False), (0, 1, False), (2.9, 1, False), (3.1, 1, True)],
        *[(0, -0.1, True), (0, 0.1, False), (0, 1.9, False), (0, 2.1, True)],
    ],
)
def test_a_wall_hides_between_its_ends_from_the_ground_to_its_height(y, z, seen):
    """Seen level and straight ahead, so that the line of sight passes the wall at (y, z)."""
    wall = np.array([[5.0, -3.0, 5.0, 3.0, 2.0]])
    for turned in (wall, wall[:, [2, 3, 0, 1, 4]]):
        assert hidden(turned, np.array([0.0, y, z]), np.array([[9.0, y, z]])).tolist() != [seen]


def test_a_wall_hides_from_the_right_camera_too():
    """A narrow post that stands in the way of the right camera alone."""
    base = {"kind": "hover", "sway_m": [0, 0, 0], "yaw_deg": 0}
    rig = {"baseline_m": 0.6, "imu_cam": {"translation_m": [0, 0, 1.0]}, "depth_m": [1.0, 30.0]}
    landmarks = {"kind": "box", "count": 20, "size_m": [0, 0.1, 0.1], "center_m": [10.0, 0, 1.0]}
    open_ = scene(trajectory=base, rig=rig, landmarks=landmarks, duration_s=1.0)
    assert len(simulate(open_).sightings) == 20 * 11
    # the right camera stands at y = -0.6; at x = 1 its lines of sight pass y = -0.54
    post = scene(
        trajectory=base,
        rig=rig,
        landmarks=landmarks,
        duration_s=1.0,
        camera={"walls": [[1.0, -0.6, 1.0, -0.5, 3.0], [1.0, 5.0, 1.0, 6.0, 3.0]]},
    )
    with pytest.raises(Exception, match="no landmark is ever seen"):
        simulate(post)


CHANCES = {
    "dropout": {"dropout": 0.2},
    "half_missing": {"half_missing": 0.2},
    "outliers": {"outliers": {"share": 0.2, "size_px": 30.0}},
}


@pytest.mark.parametrize("name", CHANCES)
def test_share_is_what_the_scene_says(name):
    """About 5,400 sightings of 5 seeds; binomial, two-sided, 1 false alarm in 1,000 each."""
    from scipy.stats import binomtest

    hit = total = 0
    for seed in range(5):
        plain = pixels_by_sighting(simulate(scene(), seed))
        changed = pixels_by_sighting(simulate(scene(camera=CHANCES[name]), seed))
        total += len(plain)
        hit += sum(changed.get(key) != value for key, value in plain.items())
        assert changed.keys() <= plain.keys()
    assert binomtest(hit, total, 0.2).pvalue > 1e-3


@pytest.mark.parametrize("name", CHANCES)
def test_chance_of_one_kind_leaves_all_other_readings_alone(name):
    raw = {"raw": {"rate_hz": 50.0}}
    plain = simulate(scene(imu=raw))
    changed = simulate(scene(imu=raw, camera=CHANCES[name]))
    for attribute in ("times_s", "linear_velocity", "angular_velocity"):
        assert getattr(plain, attribute).tobytes() == getattr(changed, attribute).tobytes()
    assert plain.imu.gyro.tobytes() == changed.imu.gyro.tobytes()
    assert plain.imu.accel.tobytes() == changed.imu.accel.tobytes()
    assert plain.prior.T_world_imu.tobytes() == changed.prior.T_world_imu.tobytes()
    before, after = pixels_by_sighting(plain), pixels_by_sighting(changed)
    touched = sum(before[key] != value for key, value in after.items())
    assert (touched == 0) == (name == "dropout")
    assert touched < 0.3 * len(before)


def test_all_kinds_of_chance_are_independent_of_each_other():
    """Outliers are as frequent among the lost as among the kept: Fisher, 1 in 1,000 a pair."""
    from scipy.stats import fisher_exact

    plain, hit = {}, {name: set() for name in CHANCES}
    for seed in range(5):
        before = pixels_by_sighting(simulate(scene(), seed))
        plain |= {(seed, key): value for key, value in before.items()}
        for name, changes in CHANCES.items():
            after = pixels_by_sighting(simulate(scene(camera=changes), seed))
            hit[name] |= {(seed, key) for key, value in before.items() if after.get(key) != value}
    for a, b in (
        ("dropout", "outliers"),
        ("dropout", "half_missing"),
        ("outliers", "half_missing"),
    ):
        both, n = len(hit[a] & hit[b]), len(plain)
        table = [[both, len(hit[a]) - both], [len(hit[b]) - both, n - len(hit[a] | hit[b])]]
        assert fisher_exact(table).pvalue > 1e-3


def test_a_half_missing_feature_lacks_either_image_as_often():
    """Binomial, two-sided, 1 false alarm in 1,000."""
    from scipy.stats import binomtest

    left = right = 0
    for seed in range(5):
        pixels = simulate(scene(camera={"half_missing": 0.3}), seed).sightings.pixels
        missing = pixels == -1
        assert (missing[:, 0] == missing[:, 1]).all()
        assert (missing[:, 2] == missing[:, 3]).all()
        assert not missing.all(axis=1).any()
        left, right = left + missing[:, 0].sum(), right + missing[:, 2].sum()
    assert binomtest(int(left), int(left + right)).pvalue > 1e-3


def test_outliers_are_off_by_their_size_in_any_direction():
    """Mean and spread of each coordinate where none is lost; two-sided, 1 false alarm in 1,000.

    A coordinate of a uniform direction in four dimensions has the moments 0, 1/4, 0, 1/8.
    """
    from scipy.stats import norm

    parts = []
    for seed in range(10):
        data = simulate(
            scene(camera={"sigma_px": 1e-6, "outliers": {"share": 1.0, "size_px": 30.0}}), seed
        )
        parts.append((data.sightings.pixels - true_pixels(data))[clear_of_borders(data, 30)])
    moved = np.concatenate(parts) / 30
    n, limit = len(moved), norm.isf(1e-3 / 2 / 8)
    assert n > 500
    np.testing.assert_allclose(np.linalg.norm(moved, axis=1), 1, atol=1e-5)
    assert np.abs(moved.mean(axis=0)).max() < limit * np.sqrt(1 / 4 / n)
    assert np.abs(np.square(moved).mean(axis=0) - 1 / 4).max() < limit * np.sqrt(1 / 16 / n)


def test_taking_the_last_landmark_away_changes_no_other_pixel():
    many = pixels_by_sighting(simulate(scene(RICH)))
    for count in (39, 25):
        few = pixels_by_sighting(simulate(scene(RICH, landmarks={"count": count})))
        assert few == {key: value for key, value in many.items() if key[1] < count}


def test_noise_depends_on_landmark_and_frame_not_on_what_else_is_seen():
    near = pixels_by_sighting(simulate(scene(rig={"depth_m": [2.0, 8.0]})))
    all_ = pixels_by_sighting(simulate(scene()))
    assert near.items() < all_.items()


def straight_tracks(tracks):
    return scene(
        duration_s=30.0,
        trajectory={"kind": "straight", "speed_mps": 10.0},
        landmarks={"kind": "path", "count": 1500, "lateral_m": [3.0, 20.0]},
        rig={"depth_m": [3.0, 120.0]},
        camera={"sigma_px": 0.3, "tracks": tracks},
    )


@pytest.mark.parametrize(
    ("median", "shortest", "longest"), [(10, 3, 60), (20, 20, 20), (7, 7, 40), (9, 4, 9)]
)
def test_tracks_have_the_wanted_median_minimum_and_maximum_and_no_gap(median, shortest, longest):
    wanted = {"median_frames": median, "min_frames": shortest, "max_frames": longest}
    data = simulate(straight_tracks(wanted))
    ids, frames = data.sightings.ids, of_frame(data)
    lengths = np.array([np.ptp(frames[ids == j]) + 1 for j in np.unique(ids)])
    assert len(ids) == lengths.sum()
    assert len(lengths) > 800
    assert lengths.min() >= shortest
    assert lengths.max() <= longest
    assert abs(np.median(lengths) - median) <= 1


def test_tracks_lie_anywhere_in_the_span_that_a_landmark_is_in_view():
    """Or every landmark would be known from afar alone."""
    wanted = {"median_frames": 5, "min_frames": 5, "max_frames": 5}
    short = simulate(straight_tracks(wanted))
    always = simulate(straight_tracks(None))
    first = {
        j: i for i, j in reversed(list(zip(of_frame(always), always.sightings.ids, strict=True)))
    }
    last = dict(zip(always.sightings.ids, of_frame(always), strict=True))
    start = {
        j: i for i, j in reversed(list(zip(of_frame(short), short.sightings.ids, strict=True)))
    }
    place = [
        (start[j] - first[j]) / (last[j] - 4 - first[j]) for j in start if last[j] - first[j] > 30
    ]
    assert 0.4 < np.mean(place) < 0.6
    assert np.std(place) > 0.2
