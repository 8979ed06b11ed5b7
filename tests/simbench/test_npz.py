"""The file format: what is written, what comes back, and what is refused."""

import io
import struct
import zipfile
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simbench.dataset import Dataset
from simbench.errors import DatasetError
from simbench.limits import limited_to
from simbench.noise import estimate
from simbench.npz import archive, dialect_of, read_npz, write_npz
from simbench.sensors import simulate
from tests.simbench.scenes import PLAIN, RICH, differences, scene
from vislam.types import Noise

REAL = Path(__file__).parents[3] / "shared/data"
real = pytest.mark.skipif(not REAL.is_dir(), reason="the real files are not beside the project")
OWN = {"truth_", "prior_", "noise_", "imu_time", "imu_gyro", "imu_accel", "gate", "image_size"}


@pytest.fixture(scope="module")
def rich() -> Dataset:
    return simulate(scene(RICH))


@pytest.fixture
def path(tmp_path, rich) -> Path:
    """A file of the rich scene."""
    write_npz(tmp_path / "rich.npz", rich)
    return tmp_path / "rich.npz"


@pytest.fixture(scope="module")
def short_file(tmp_path_factory) -> bytes:
    """The bytes of a small file."""
    path = tmp_path_factory.mktemp("short") / "short.npz"
    write_npz(path, simulate(scene(RICH, duration_s=0.5)))
    return path.read_bytes()


def contents(path):
    with np.load(path, allow_pickle=False) as file:
        return dict(file)


def foreign(path, **changes):
    """The file as others write it: the format's keys alone, some changed or (None) left out."""
    arrays = {k: v for k, v in contents(path).items() if not k.startswith(tuple(OWN))}
    for key in ("scenario_yaml", "seed", "run", "simbench_version"):
        arrays.pop(key, None)
    arrays |= changes
    np.savez_compressed(path, **{k: v for k, v in arrays.items() if v is not None})
    return path


def changed(path, **changes):
    """The file with all its keys, some changed or (None) left out."""
    arrays = contents(path) | changes
    np.savez_compressed(path, **{k: v for k, v in arrays.items() if v is not None})
    return path


# what is written


def test_a_file_is_what_readers_of_the_format_expect(path, rich):
    arrays, T, M = contents(path), len(rich), rich.landmark_count
    shapes = {
        "time_stamps": (1, T),
        "linear_velocity": (3, T),
        "angular_velocity": (3, T),
        "features": (4, M, T),
        "K": (3, 3),
        "b": (),
        "imu_T_cam": (4, 4),
        "truth_world_T_imu": (T, 4, 4),
        "truth_landmarks": (3, M),
        "truth_linear_velocity": (3, T),
        "truth_angular_velocity": (3, T),
        "truth_imu_T_cam": (4, 4),
        "truth_b": (),
        "prior_world_T_imu": (4, 4),
        "prior_covariance": (6, 6),
        "noise_pixel": (4,),
        "noise_linear_velocity": (3,),
        "noise_angular_velocity": (3,),
        "image_size": (2,),
        "imu_time_stamps": (1, len(rich.imu.times_s)),
        "imu_gyro": (3, len(rich.imu.times_s)),
        "imu_accel": (3, len(rich.imu.times_s)),
        "truth_gyro_bias": (3, len(rich.imu.times_s)),
        "truth_accel_bias": (3, len(rich.imu.times_s)),
    }
    for key, shape in shapes.items():
        assert (arrays[key].shape, arrays[key].dtype) == (shape, np.float64), key
    assert arrays["seed"] == 3
    assert arrays["run"] == 0
    assert arrays["scenario_yaml"] == rich.origin.scenario_yaml
    np.testing.assert_allclose(arrays["noise_linear_velocity"], [0.07, 0.14, 0.21])
    np.testing.assert_allclose(arrays["noise_angular_velocity"], [0.007, 0.014, 0.021])


def test_the_dense_array_holds_the_sightings_and_minus_one_elsewhere(path, rich):
    dense = np.full((4, rich.landmark_count, len(rich)), -1.0)
    for i in range(len(rich)):
        dense[:, rich.frame(i).ids, i] = rich.frame(i).pixels.T
    np.testing.assert_array_equal(contents(path)["features"], dense)


def test_a_dense_array_of_several_blocks_is_the_same(path, rich, monkeypatch):
    whole = path.read_bytes()
    monkeypatch.setattr(archive, "BLOCK_BYTES", 8 * 100)
    write_npz(path, rich)
    assert path.read_bytes() == whole
    assert not differences(read_npz(path).sightings, rich.sightings)


def test_equal_datasets_give_equal_bytes_at_any_time_and_thread_count(path, monkeypatch):
    from threadpoolctl import threadpool_limits

    monkeypatch.setattr("time.time", lambda: 2_000_000_000.0)
    for threads in (1, 2):
        with threadpool_limits(threads):
            write_npz(path.with_name("again.npz"), simulate(scene(RICH)))
        assert path.with_name("again.npz").read_bytes() == path.read_bytes()
    with zipfile.ZipFile(path) as zip_:
        assert {info.date_time[0] for info in zip_.infolist()} == {1980}


def test_additive_noise_is_written_as_the_sigma_of_a_sample_too(path):
    data = simulate(scene(PLAIN, filter={"process_noise": "additive"}))
    write_npz(path, data)
    np.testing.assert_allclose(contents(path)["noise_linear_velocity"], 0.2, rtol=1e-9)
    assert not differences(read_npz(path).noise, data.noise)


def test_a_rate_of_zero_is_never_written(path, rich):
    write_npz(path, replace(rich, angular_velocity=np.zeros((len(rich), 3))))
    assert (np.linalg.norm(contents(path)["angular_velocity"], axis=0) > 0).all()


# what comes back


@pytest.mark.parametrize("process_noise", ["twist", "additive"])
@pytest.mark.parametrize("base", [RICH, PLAIN], ids=lambda base: base["name"])
def test_a_generated_file_gives_the_same_dataset_back_to_the_bit(tmp_path, base, process_noise):
    data = simulate(scene(base, filter={"process_noise": process_noise}), seed=11, run=4)
    path = tmp_path / f"{data.name}.npz"
    write_npz(path, data)
    assert differences(read_npz(path), data) == [".notes"]


def test_a_read_file_is_written_again_to_the_same_bytes(path):
    write_npz(path.with_name("again.npz"), read_npz(path))
    assert path.with_name("again.npz").read_bytes() == path.read_bytes()


def test_a_foreign_file_is_told_what_its_data_show_and_says_so(path, rich):
    data = read_npz(foreign(path))
    found = estimate(rich)
    assert data.noise.sigma_px.tolist() == [found.sigma_px] * 4
    sigma_u = np.concatenate([found.velocity, found.angular])
    np.testing.assert_allclose(data.noise.process, np.diag(sigma_u**2))
    assert data.noise.process_model == "twist"
    assert data.gate == 0.999
    assert not differences(data.prior.T_world_imu, np.eye(4))
    assert not data.prior.pose_covariance.any()
    assert data.calibration.rig.image_px is None
    assert data.calibration.rig.min_disparity_px == 1
    assert data.truth is data.imu is data.origin is None
    assert not differences(data.sightings, rich.sightings)
    told = (
        f"says nothing of noise. As estimated from its data, filters are told {found.sigma_px:.2g}"
    )
    assert any(told in note for note in data.notes)


def test_noise_told_by_the_caller_overrules_defaults_and_the_file(path):
    told = {"noise_pixel_px": 3.0, "noise_velocity": 0.4, "noise_angular": 0.3}
    expected = np.diag([0.4**2] * 3 + [0.3**2] * 3)
    for file in (path, foreign(path)):
        noise = read_npz(file, **told).noise
        np.testing.assert_allclose(noise.process, expected)
        assert noise.sigma_px.tolist() == [3, 3, 3, 3]


def test_one_overruled_sigma_leaves_the_others_as_the_file_has_them(path, rich):
    noise = read_npz(path, noise_angular=0.3).noise
    np.testing.assert_array_equal(noise.process[:3, :3], rich.noise.process[:3, :3])
    assert noise.process[4, 4] == pytest.approx(0.09)
    assert not differences(noise.sigma_px, rich.noise.sigma_px)


def test_the_dialect_of_2019_is_read(path, rich):
    arrays = contents(path)
    foreign(
        path,
        rotational_velocity=arrays["angular_velocity"],
        angular_velocity=None,
        cam_T_imu=np.linalg.inv(arrays["imu_T_cam"]),
        imu_T_cam=None,
    )
    data = read_npz(path, extrinsics="cam_T_imu", imu_frame="flu")
    assert not differences(data.angular_velocity, rich.angular_velocity)
    np.testing.assert_allclose(data.calibration.T_imu_cam, rich.calibration.T_imu_cam, atol=1e-12)
    assert dialect_of(path) == "2019"


def test_a_file_without_features_is_read_for_dead_reckoning(path):
    data = read_npz(foreign(path, features=None))
    assert data.sightings is None
    assert data.landmark_count == 0
    assert any("no features" in note for note in data.notes)
    assert dialect_of(path) == "2021"


def test_dialects_are_named(path):
    assert dialect_of(path) == "simbench"
    assert dialect_of(foreign(path)) == "2022"


@pytest.mark.parametrize("dtype", [np.float32, ">f8"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_features_of_another_type_or_order_are_read(path, rich, dtype, order):
    features = np.asarray(contents(path)["features"], dtype=dtype, order=order)
    data = read_npz(changed(path, features=features))
    assert not differences(data.sightings.ids, rich.sightings.ids)
    pixels = rich.sightings.pixels.astype(dtype).astype(float)
    assert not differences(data.sightings.pixels, pixels)


def test_times_are_taken_to_whole_nanoseconds(path):
    unix = 1_317_384_506.0 + contents(path)["time_stamps"]
    data = read_npz(foreign(path, time_stamps=unix))
    assert (np.diff(data.times_ns) > 0).all()
    np.testing.assert_array_equal(data.times_s, unix[0])  # floats are further apart there
    fine = read_npz(foreign(path, time_stamps=contents(path)["time_stamps"] + 1e-10))
    np.testing.assert_array_equal(fine.times_ns, np.rint(fine.times_s * 1e9))


def test_a_rotation_of_few_digits_is_made_exact_and_only_a_change_that_shows_is_noted(path):
    given = contents(path)["imu_T_cam"]
    for digits, noted in ((8, False), (4, True)):
        data = read_npz(foreign(path, imu_T_cam=np.round(given, digits)))
        R = data.calibration.T_imu_cam[:3, :3]
        np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-15)
        np.testing.assert_allclose(R, given[:3, :3], atol=10.0**-digits)
        assert any("mended" in note for note in data.notes) == noted


# what is refused


def bad_K(i, j, value):
    K = np.array([[552.0, 0, 682], [0, 552, 238], [0, 0, 1]])
    K[i, j] = value
    return K


def one(shape, at, value):
    array = np.linspace(0, 1, int(np.prod(shape))).reshape(shape)
    array[at] = value
    return array


T, M, N = 41, 40, 401
FAULTS = [
    (
        {"time_stamps": None},
        "time_stamps: expected this key, the file holds K, angular_velocity, b",
    ),
    ({"imu_T_cam": None}, r"imu_T_cam \(or cam_T_imu\): expected this key"),
    ({"angular_velocity": None}, r"angular_velocity \(or rotational_velocity\): expected this"),
    ({"time_stamps": np.arange(T) / 10}, r"time_stamps: expected shape \(1, T\), got \(41,\)"),
    ({"time_stamps": one((1, T), (0, 7), 0.1)}, r"time_stamps: .* increase, but at index 7"),
    ({"time_stamps": np.arange(T)[None] * 1e-10}, "time_stamps: .* increase, but at index 1 "),
    ({"time_stamps": one((1, T), (0, 40), 1e18)}, r"time_stamps: expected seconds, got 1e\+18"),
    (
        {"angular_velocity": np.ones((3, 40))},
        r"angular_velocity: expected shape \(3, T\) with T = 41 as in time_stamps, got \(3, 40\)",
    ),
    ({"linear_velocity": np.ones((T, 3))}, r"linear_velocity: expected shape \(3, T\)"),
    ({"linear_velocity": one((3, T), (1, 5), np.nan)}, r"linear_velocity: .* got nan at \[1, 5\]"),
    ({"b": np.array(np.inf)}, "b: expected finite numbers, got inf"),
    ({"b": np.array(0.0)}, "b: expected what is positive, got 0.0"),
    ({"b": np.ones(1)}, r"b: expected shape \(\), got \(1,\)"),
    ({"K": bad_K(0, 1, 0.1)}, "K: expected .*fx, 0, cx"),
    ({"K": bad_K(2, 2, 2.0)}, "K: expected .*fx, 0, cx"),
    ({"K": bad_K(1, 1, -552.0)}, "K: expected positive focal lengths, got 552 and -552"),
    ({"imu_T_cam": np.diag([1.0, 1, 1.1, 1])}, "imu_T_cam: expected a rigid motion .* off by 0.21"),
    ({"imu_T_cam": np.diag([1.0, 1, -1, 1])}, "imu_T_cam: expected a rigid motion .* det R = -1"),
    ({"imu_T_cam": np.eye(4).T + np.eye(4, k=-3)}, "imu_T_cam: .* last row"),
    ({"features": np.ones((4, M, 3))}, r"features: expected shape \(4, M, T\) with T = 41"),
    ({"features": np.ones((3, M, T))}, r"features: expected shape \(4, M, T\), got \(3, 40, 41\)"),
    ({"features": one((4, M, T), (2, 5, 7), np.nan)}, "features: expected finite numbers, got nan"),
    ({"features": np.array(["x"])}, "features: expected real numbers, got dtype <U1"),
    ({"K": np.eye(3) * 1j}, "K: expected real numbers, got dtype complex128"),
    ({"b": np.array([{}], object)}, "b: expected real numbers, got dtype object"),
    ({"truth_b": None}, "truth_b: expected this key beside truth_world_T_imu, got none"),
    ({"noise_pixel": np.zeros(4)}, "noise_pixel: expected what is positive"),
    ({"noise_process": np.eye(6, k=1)}, "noise_process: expected a symmetric positive"),
    ({"prior_covariance": -np.eye(6)}, "prior_covariance: expected a symmetric positive"),
    ({"noise_process_model": np.array("white")}, "noise_process_model: expected one of"),
    ({"scenario_yaml": np.array(3.0)}, "scenario_yaml: expected a text, got dtype float64"),
    ({"seed": np.array(3.5)}, "seed: expected a whole number, got dtype float64"),
    ({"run": np.arange(3)}, "run: expected one number"),
    ({"gate": np.array(1.5)}, "gate: expected a probability below 1"),
    ({"truth_world_T_imu": np.zeros((T, 4, 4))}, "truth_world_T_imu: expected a rigid motion"),
    ({"truth_landmarks": np.zeros((3, M + 1))}, r"features: .* M = 41 as in truth_landmarks"),
    ({"imu_gyro": np.zeros((3, N - 1))}, r"imu_gyro: .* N = \d+ as in imu_time_stamps"),
    ({"image_size": np.array([1242.0, 0.0])}, "image_size: expected what is positive"),
]


@pytest.mark.parametrize(
    ("changes", "message"), FAULTS, ids=lambda v: v if isinstance(v, str) else ""
)
def test_a_fault_is_refused_with_its_file_and_key(path, changes, message):
    changed(path, **changes)
    with pytest.raises(DatasetError, match=rf"rich\.npz: {message}"):
        read_npz(path)


def test_what_is_no_file_or_no_archive_says_so(tmp_path):
    with pytest.raises(DatasetError, match="No such file"):
        read_npz(tmp_path / "none.npz")
    with pytest.raises(DatasetError, match="Is a directory"):
        read_npz(tmp_path)
    (tmp_path / "text.npz").write_text("a: b")
    with pytest.raises(DatasetError, match=r"text\.npz: expected an \.npz archive"):
        read_npz(tmp_path / "text.npz")


def member(path, name, raw):
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as zip_:
        zip_.writestr(f"{name}.npy", raw)
    return path


def header(shape, descr="<f8"):
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        file, {"descr": descr, "fortran_order": False, "shape": shape}
    )
    return file.getvalue()


def test_a_header_that_promises_more_than_there_is_allocates_nothing(path):
    member(foreign(path, features=None), "features", header((4, 10**9, 10**9)))
    with pytest.raises(DatasetError, match="features: expected 32000000000000000000 bytes"):
        read_npz(path)


def test_an_archive_that_declares_more_than_the_limit_is_refused_unread(path):
    with (
        limited_to(1 << 16),
        pytest.raises(
            DatasetError, match=r"the archive, unpacked, takes .* limit of 64 KB.*--limit"
        ),
    ):
        read_npz(path)


def test_features_that_are_all_seen_beyond_reason_are_refused_as_they_are_read(path):
    foreign(path, features=np.ones((4, M, T)))
    with limited_to(800_000), pytest.raises(DatasetError, match="features: 6560 coordinates or"):
        read_npz(path)


def test_frames_beyond_reason_are_refused(path):
    foreign(path, features=None)
    with limited_to(40_000), pytest.raises(DatasetError, match="a drive of 41 frames takes"):
        read_npz(path)


@pytest.mark.parametrize(
    "raw",
    [
        b"",
        b"\x93NUMPY",
        b"\x93NUMPY\x09\x00" + bytes(50),
        b"\x93NUMPY\x01\x00\xff\xff{",
        b"x" * 99,
        b"\x93NUMPY\x01\x00\x08\x00{'descr'",
        b"\x93NUMPY\x01\x00\x08\x00\xff(((((((",
    ],
)
def test_a_member_that_is_no_array_is_refused(path, raw):
    member(foreign(path, b=None), "b", raw)
    with pytest.raises(DatasetError, match=r"rich\.npz: b: "):
        read_npz(path)


@given(st.data())
def test_a_damaged_file_is_refused_or_still_reads(tmp_path_factory, short_file, data):
    """Cut anywhere, or with bytes changed anywhere: never another error than ours."""
    path, whole = tmp_path_factory.getbasetemp() / "damaged.npz", short_file
    if data.draw(st.booleans()):
        path.write_bytes(whole[: data.draw(st.integers(0, len(whole) - 1))])
        with pytest.raises(DatasetError):
            read_npz(path)
        return
    raw = bytearray(whole)
    for _ in range(data.draw(st.integers(1, 4))):
        # from either end, so that headers and the directory are hit as often as the data
        at = data.draw(st.integers(-2000, 2000) | st.integers(0, len(whole) - 1))
        raw[at % len(raw)] = data.draw(st.integers(0, 255))
    path.write_bytes(raw)
    with suppress(DatasetError):
        read_npz(path)


@pytest.mark.parametrize(
    ("signature", "at", "value"),
    [(b"PK\x01\x02", 6, 200), (b"PK\x01\x02", 45, 255), (b"PK\x01\x02", 10, 99)],
    ids=["version", "offset", "compression"],
)
def test_a_directory_that_makes_no_sense_is_refused(path, signature, at, value):
    raw = bytearray(path.read_bytes())
    raw[raw.find(signature) + at] = value
    path.write_bytes(raw)
    with pytest.raises(DatasetError, match=r"rich\.npz"):
        read_npz(path)


def test_an_encrypted_member_is_refused(path):
    foreign(path)
    raw = bytearray(path.read_bytes())
    for signature, flags in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        at = raw.find(signature)
        raw[at + flags : at + flags + 2] = struct.pack("<H", 1)
    path.write_bytes(raw)
    with pytest.raises(DatasetError, match="expected no encryption"):
        read_npz(path)


# real files


@real
@pytest.mark.parametrize(
    ("name", "landmarks", "frames", "dialect"),
    [
        ("2019/0020", 260, 1104, "2019"),
        ("2021/03", 0, 1010, "2021"),
        ("2022/03", 5105, 1010, "2022"),
    ],
)
def test_a_real_file_is_read(name, landmarks, frames, dialect):
    path = REAL / f"{name}.npz"
    data = read_npz(path)
    assert (data.landmark_count, len(data)) == (landmarks, frames)
    assert dialect_of(path) == dialect
    R = data.calibration.T_imu_cam[:3, :3]
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-14)
    assert isinstance(data.noise, Noise)


@real
def test_the_sightings_of_a_real_file_are_those_of_its_dense_array():
    path = REAL / "2019/0020.npz"
    data, dense = read_npz(path), contents(path)["features"]
    for i in range(0, len(data), 13):
        seen = np.flatnonzero((dense[:, :, i] != -1).any(axis=0))
        assert data.frame(i).ids.tolist() == seen.tolist()
        np.testing.assert_array_equal(data.frame(i).pixels, dense[:, seen, i].T)
