"""What is written in each dialect is read by programs that nobody here wrote."""

import pickle
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simbench.dataset import Sightings
from simbench.errors import DatasetError, InputError
from simbench.npz import Dialect, dialect_of, read_convention, read_npz, write_npz
from simbench.sensors import simulate
from tests.oracles import course_readers as course
from tests.simbench.scenes import RICH, differences, scene

FRD = np.diag([1.0, -1.0, -1.0, 1.0])
OPTICAL_REGULAR = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
SILENT = {
    "imu": {"velocity": {"sigma": 1e-9}, "angular_velocity": {"sigma": 1e-9}},
    "camera": {"sigma_px": 1e-3},
    "rig": {"imu_cam": {"rotvec_deg": [2.0, -3.0, 4.0]}},
    "duration_s": 6.0,
}


@pytest.fixture(scope="module")
def silent():
    """A drive of which the truth can be read off."""
    return simulate(scene(**SILENT))


@pytest.fixture(scope="module")
def rich():
    return simulate(scene(RICH))


def inverted_about_position(cam_T_imu):
    """As those read 2019's files who found out: the translation is the camera's position."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = cam_T_imu[:3, :3].T, cam_T_imu[:3, 3]
    return T


def off(data, points, ids):
    """The median distance of points from the landmarks that they are of."""
    return np.median(np.linalg.norm(points.T - data.truth.landmarks[ids], axis=1))


def of_npz(data, path, load, imu_T_cam):
    """How far a reader of an `.npz` is off, of the path and of the landmarks."""
    t, features, v, w, K, b, T = load(path)
    poses = course.dead_reckoning(t, v, w)
    path_off = np.abs(np.moveaxis(poses, -1, 0) - data.truth.T_world_imu).max()
    return path_off, off(data, *course.landmarks_by_disparity(poses, features, K, b, imu_T_cam(T)))


def of_npy(data, path, optical_T_imu):
    """The same of one of 2025's, with two projection matrices."""
    v, w, t, features, K_l, K_r, L, R = course.load_2025(path)
    poses = np.moveaxis(course.dead_reckoning(t[None], v.T, w.T), -1, 0)
    path_off = np.abs(poses - data.truth.T_world_imu).max()
    some = features[:, ::3, ::5]
    points, ids = course.landmarks_by_two_rays(
        poses[::5], some, K_l, K_r, optical_T_imu(L), optical_T_imu(R)
    )
    return path_off, off(data, points, 3 * ids)


#: How readers take an extrinsic matrix, and the dialects that suit them.
READERS_OF_NPZ = {
    "2019 literally": (course.load_2019, np.linalg.inv, {"2019", "2020"}),
    "2019 knowing": (course.load_2019, inverted_about_position, {"2019-as-distributed"}),
    "2022 literally": (course.load_2021, lambda T: T, {"2022", "2023"}),
    "2022 flipped": (course.load_2021, lambda T: FRD @ T, {"2022-as-distributed"}),
}
READERS_OF_NPY = {
    "optical": (lambda T: T, {"2025", "2025:cam_T_imu"}),
    "inverse": (np.linalg.inv, {"2025:imu_T_cam"}),
    "regular": (lambda T: OPTICAL_REGULAR @ T, {"2025:cam_T_imu/flu/regular"}),
    "regular inverse": (lambda T: OPTICAL_REGULAR @ np.linalg.inv(T), {"2025-as-distributed"}),
}


@pytest.mark.parametrize("name", READERS_OF_NPZ)
def test_readers_of_npz_find_their_way_in_the_dialects_that_suit_them(tmp_path, silent, name):
    load, imu_T_cam, suits = READERS_OF_NPZ[name]
    year = "2019" if load is course.load_2019 else "2022"
    for dialect in suits | {year, f"{year}-as-distributed"}:
        write_npz(tmp_path / "a.npz", silent, Dialect.named(dialect))
        path_off, landmarks_off = of_npz(silent, tmp_path / "a.npz", load, imu_T_cam)
        assert path_off < 1e-6
        assert (landmarks_off < 0.01) == (dialect in suits), (dialect, landmarks_off)
        assert landmarks_off < 0.01 or landmarks_off > 0.3


@pytest.mark.parametrize("name", READERS_OF_NPY)
def test_readers_of_npy_find_their_way_in_the_dialects_that_suit_them(tmp_path, silent, name):
    optical_T_imu, suits = READERS_OF_NPY[name]
    for dialect in set().union(*(suits for _, suits in READERS_OF_NPY.values())):
        write_npz(tmp_path / "a.npy", silent, Dialect.named(dialect))
        path_off, landmarks_off = of_npy(silent, tmp_path / "a.npy", optical_T_imu)
        assert path_off < 1e-6
        assert (landmarks_off < 0.01) == (dialect in suits), (dialect, landmarks_off)


def test_a_reader_without_features_reads_2021(tmp_path, rich):
    write_npz(tmp_path / "a.npz", rich, Dialect.named("2021"))
    t, _, v, w, *_ = course.load_2021(tmp_path / "a.npz", load_features=False)
    assert t.shape == (1, len(rich))
    np.testing.assert_array_equal(v.T, rich.linear_velocity)
    np.testing.assert_array_equal(w.T, rich.angular_velocity)
    with pytest.raises(KeyError):
        course.load_2021(tmp_path / "a.npz")


@pytest.mark.parametrize("year", ["2019", "2021", "2022"])
def test_arrays_are_as_numpy_itself_would_write_them(tmp_path, rich, year):
    write_npz(tmp_path / "a.npz", rich, Dialect.named(year))
    with np.load(tmp_path / "a.npz", allow_pickle=False) as file:
        arrays = dict(file)
    np.savez_compressed(tmp_path / "b.npz", **arrays)
    with zipfile.ZipFile(tmp_path / "a.npz") as a, zipfile.ZipFile(tmp_path / "b.npz") as b:
        assert a.namelist() == b.namelist()
        for ours, theirs in zip(a.infolist(), b.infolist(), strict=True):
            assert a.read(ours) == b.read(theirs), ours.filename
            kinds = (ours.compress_type, ours.date_time, ours.create_system)
            assert kinds == (theirs.compress_type, theirs.date_time, theirs.create_system)
    texts = {"scenario_yaml", "simbench_version", "noise_process_model", "seed", "run"}
    for key in arrays.keys() - texts:
        assert arrays[key].dtype == np.float64, key
        assert arrays[key].flags.c_contiguous, key


def test_the_dict_of_2025_has_the_shapes_and_order_of_the_course(tmp_path, rich):
    path = tmp_path / "a.npy"
    write_npz(path, rich, Dialect.named("2025"))
    content = np.load(path, allow_pickle=True).item()
    T, M = len(rich), rich.landmark_count
    shapes = {"v_t": (T, 3), "w_t": (T, 3), "timestamps": (T,), "features": (4, M, T)}
    shapes |= {"K_l": (3, 3), "K_r": (3, 3), "extL_T_imu": (4, 4), "extR_T_imu": (4, 4)}
    for key, shape in shapes.items():
        assert (content[key].shape, content[key].dtype) == (shape, np.float64), key
        assert content[key].flags.c_contiguous, key
    assert not {"K", "b", "imu_T_cam", "time_stamps"} & content.keys()
    np.save(tmp_path / "b.npy", content)
    assert pickle.loads((tmp_path / "b.npy").read_bytes()[128:]).item().keys() == content.keys()
    write_npz(tmp_path / "c.npy", simulate(scene(RICH)), Dialect.named("2025"))
    assert (tmp_path / "c.npy").read_bytes() == path.read_bytes()


@given(
    pixels=st.lists(st.tuples(*[st.floats(0, 1000)] * 3), min_size=1, max_size=5),
    still=st.booleans(),
)
def test_nothing_is_written_that_readers_divide_by(tmp_path_factory, silent, pixels, still):
    """Neither uL == uR nor a rate of zero, whatever the dataset holds; all else is untouched."""
    path = tmp_path_factory.getbasetemp() / "level.npz"
    level = np.array([[u, v, u, w] for u, v, w in pixels])
    frames = [(np.arange(len(level)), level)] + [(np.empty(0, np.int64), np.empty((0, 4)))] * (
        len(silent) - 1
    )
    rates = silent.angular_velocity.copy()
    rates[3] = 0 if still else 0.5
    write_npz(
        path,
        replace(silent, sightings=Sightings.from_frames(frames), angular_velocity=rates),
    )
    with np.load(path) as file:
        seen = file["features"][:, : len(level), 0]
        assert (seen[0] > seen[2]).all()
        np.testing.assert_allclose(seen[2], level[:, 0], rtol=1e-15, atol=1e-300)
        np.testing.assert_array_equal(seen[[0, 1, 3]].T, level[:, [0, 1, 3]])
        assert np.linalg.norm(file["angular_velocity"], axis=0).min() > 0
        np.testing.assert_allclose(file["angular_velocity"][:, 3], rates[3], atol=1e-15)


# what comes back

DIALECTS = [
    *("2019", "2019-as-distributed", "2022", "2022-as-distributed", "2022:cam_T_imu/frd"),
    *("2019:imu_T_cam/frd", "2025", "2025-as-distributed", "2025:imu_T_cam"),
    "2025:cam_T_imu/flu/regular",
]


@pytest.mark.parametrize("name", DIALECTS)
def test_a_dataset_comes_back_from_every_dialect_its_reading_found_from_the_data(tmp_path, name):
    data = simulate(scene(RICH, told={"rotation_error_deg": [0, 0, 0]}))
    dialect = Dialect.named(name)
    path = tmp_path / f"rich{dialect.suffix}"
    write_npz(path, data, dialect)
    back, convention = read_npz(path), read_convention(path)
    assert convention.chosen.meaning == dialect.meaning
    assert convention.clear
    assert len(convention.readings) == (4 if dialect.year == "2025" else 6)
    assert dialect_of(path) == ("simbench" if dialect.year == "2022" else dialect.year)
    assert set(differences(back, data)) <= {
        ".notes",
        ".calibration.T_imu_cam",
        ".calibration.rig.baseline_m",
    }
    np.testing.assert_allclose(back.calibration.T_imu_cam, data.calibration.T_imu_cam, atol=1e-15)
    assert back.calibration.rig.baseline_m == pytest.approx(data.calibration.rig.baseline_m)


@pytest.mark.parametrize("name", ["2019", "2022-as-distributed", "2025-as-distributed"])
def test_a_wrong_convention_that_is_asked_for_is_taken_and_shows_in_its_error(
    tmp_path, silent, name
):
    dialect = Dialect.named(name)
    path = tmp_path / f"a{dialect.suffix}"
    write_npz(path, silent, dialect)
    right = read_convention(path).chosen
    wrong = "imu_T_cam" if right.meaning.extrinsics != "imu_T_cam" else "cam_T_imu"
    data = read_npz(
        path,
        extrinsics=wrong,
        imu_frame=right.meaning.imu_frame,
        camera_axes=right.meaning.camera_axes,
    )
    assert np.abs(data.calibration.T_imu_cam - silent.calibration.T_imu_cam).max() > 0.1
    assert any("as asked" in note and wrong in note for note in data.notes)
    contradicted = any("the file contradicts this reading" in note for note in data.notes)
    assert contradicted == (dialect.year == "2025")


def test_a_reading_is_named_by_its_words_and_what_is_left_out_is_usual():
    for name in ("imu_T_cam/flu/regular", "imu_T_cam/regular", "imu_T_cam/regular/flu"):
        assert Dialect.named(f"2025:{name}") == Dialect.named("2025-as-distributed")
    assert Dialect.named("2024:imu_T_cam/optical") == Dialect.named("2022-self-consistent")


@pytest.mark.parametrize(
    "name",
    ["", "22", "1999", "2022-", "2022:flu", "2022:imu_T_cam/flu/x", "2022:imu_T_cam/flu/frd"],
)
def test_a_dialect_that_is_none_is_refused(name):
    with pytest.raises(InputError, match="xpected"):
        Dialect.named(name)


# the pickled dict, as others write it


def npy(path, data, **changes):
    """A dict of 2025 with the format's keys alone, some changed or (None) left out."""
    write_npz(path, data, Dialect.named("2025"))
    content = np.load(path, allow_pickle=True).item()
    keys = ("v_t", "w_t", "timestamps", "features", "K_l", "K_r", "extL_T_imu", "extR_T_imu")
    content = {key: content[key] for key in keys} | changes
    np.save(path, {k: v for k, v in content.items() if v is not None})
    return path


def test_a_foreign_dict_is_given_the_defaults_and_says_so(tmp_path, silent):
    data = read_npz(npy(tmp_path / "dataset00.npy", silent))
    assert data.name == "dataset00"
    assert data.truth is None
    assert any("noise" in note for note in data.notes)
    assert not differences(data.sightings, silent.sightings)


def test_times_in_a_column_and_features_that_are_none_are_read(tmp_path, silent):
    column = silent.times_s[:, None]
    data = read_npz(npy(tmp_path / "a.npy", silent, timestamps=column, features=None))
    np.testing.assert_array_equal(data.times_s, silent.times_s)
    assert data.sightings is None
    content = np.load(tmp_path / "a.npy", allow_pickle=True).item() | {"features": None}
    np.save(tmp_path / "a.npy", content)
    assert read_npz(tmp_path / "a.npy").sightings is None


def test_a_right_camera_of_its_own_K_is_taken_as_one_with_the_left_K(tmp_path, silent):
    rig = silent.calibration.rig
    K_r = np.array([[rig.fx_px / 2, 0, 300], [0, rig.fy_px / 4, 100], [0, 0, 1]])
    path = npy(tmp_path / "a.npy", silent)
    features = np.load(path, allow_pickle=True).item()["features"]
    seen = features[2] != -1
    features[2] = np.where(seen, (features[2] - rig.cx_px) / 2 + 300, -1)
    features[3] = np.where(seen, (features[3] - rig.cy_px) / 4 + 100, -1)
    data = read_npz(npy(path, silent, K_r=K_r, features=features))
    np.testing.assert_allclose(data.sightings.pixels, silent.sightings.pixels, atol=1e-10)
    assert any("whose K differs" in note for note in data.notes)


def turned(degrees):
    a = np.deg2rad(degrees)
    T = np.eye(4)
    T[:2, :2] = [[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]
    return T


def test_a_right_camera_that_is_turned_a_little_is_noted_and_more_is_refused(tmp_path, silent):
    R = np.load(npy(tmp_path / "a.npy", silent), allow_pickle=True).item()["extR_T_imu"]
    data = read_npz(npy(tmp_path / "a.npy", silent, extR_T_imu=turned(0.5) @ R))
    assert any("turned by 0.5 degrees" in note for note in data.notes)
    with pytest.raises(DatasetError, match=r"extR_T_imu: expected a camera beside .* 10 degrees"):
        read_npz(npy(tmp_path / "a.npy", silent, extR_T_imu=turned(10) @ R))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"v_t": None}, r"v_t: expected this key, the file holds K_l, K_r, extL"),
        ({"v_t": np.ones((3, 61))}, r"v_t: expected shape \(T, 3\)"),
        ({"w_t": np.full((61, 3), np.nan)}, "w_t: expected finite numbers, got nan"),
        ({"timestamps": np.zeros(61)}, "timestamps: expected times that increase"),
        ({"K_r": np.ones((3, 3))}, "K_r: expected .*fx, 0, cx"),
        ({"extL_T_imu": np.ones((4, 4))}, "extL_T_imu: expected a rigid motion"),
        ({"extR_T_imu": np.zeros((4, 4))}, "extR_T_imu: expected a rigid motion"),
        ({"features": np.ones((3, 1, 61))}, r"features: expected shape \(4, M, T\)"),
        ({"features": "none"}, "features: expected real numbers, got 'none'"),
    ],
    ids=lambda v: v if isinstance(v, str) else "",
)
def test_a_fault_in_a_dict_is_refused_with_its_file_and_key(tmp_path, silent, changes, message):
    path = npy(tmp_path / "a.npy", silent, **changes)
    with pytest.raises(DatasetError, match=rf"a\.npy: {message}"):
        read_npz(path)


def test_the_two_cameras_in_one_place_are_refused(tmp_path, silent):
    L = np.load(npy(tmp_path / "a.npy", silent), allow_pickle=True).item()["extL_T_imu"]
    with pytest.raises(DatasetError, match="expected a camera beside the left one"):
        read_npz(npy(tmp_path / "a.npy", silent, extR_T_imu=L))
