"""The frames that a file means are found from its own data, and not guessed where they are not."""

from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.stats import wilcoxon

from simbench.conventions import Motion
from simbench.conventions.reading import EXACT, FALSE_ALARM, chance_of_less
from simbench.npz import Dialect, read_convention, read_npz, write_npz
from simbench.sensors import simulate
from tests.simbench.drives import drive, write_bare
from tests.simbench.scenes import PLAIN, scene

REAL = Path(__file__).parents[3] / "shared/data"
real = pytest.mark.skipif(not REAL.is_dir(), reason="the real files are not beside the project")

FRD = np.diag([1.0, -1.0, -1.0, 1.0])
STRAIGHT = {"kind": "straight", "speed_mps": 2.0}
STILL = {"kind": "hover", "sway_m": [0, 0, 0], "yaw_deg": 0}


def mixed(T_cam_imu):
    """The rotation of the inverse beside the camera's position in the IMU frame."""
    T = T_cam_imu.copy()
    T[:3, 3] = np.linalg.inv(T_cam_imu)[:3, 3]
    return T


#: What a file holds under its key, from the true T_imu_cam in FLU.
WRITTEN = {
    "imu_T_cam/flu": lambda T: T,
    "imu_T_cam/frd": lambda T: FRD @ T,
    "cam_T_imu/flu": np.linalg.inv,
    "cam_T_imu/frd": lambda T: np.linalg.inv(FRD @ T),
    "mixed/flu": lambda T: mixed(np.linalg.inv(T)),
    "mixed/frd": lambda T: mixed(np.linalg.inv(FRD @ T)),
}


def written(path, a_scene, key, name, seed=None):
    """A simulated drive in a foreign file that means its extrinsics in the named way."""
    write_npz(path, simulate(a_scene, seed))
    with np.load(path) as file:
        arrays = {
            k: file[k] for k in ("time_stamps", "linear_velocity", "angular_velocity", "features")
        }
        arrays |= {"K": file["K"], "b": file["b"], key: WRITTEN[name](file["imu_T_cam"])}
    np.savez_compressed(path, **arrays)
    return path


@pytest.mark.parametrize("name", WRITTEN)
@pytest.mark.parametrize("key", ["imu_T_cam", "cam_T_imu"])
def test_every_reading_is_found_from_a_noisy_drive_with_turns(tmp_path, key, name):
    a_scene = scene(rig={"imu_cam": {"rotvec_deg": [2.0, -3.0, 4.0]}})
    path = written(tmp_path / "d.npz", a_scene, key, name)
    convention = read_convention(path)
    assert convention.chosen.name == name
    assert convention.clear
    assert f"read as {name}, clearly" in convention.note
    np.testing.assert_allclose(
        read_npz(path).calibration.T_imu_cam, a_scene.rig.T_imu_cam, rtol=0, atol=1e-12
    )


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"trajectory": {"kind": "hover"}},
        {"trajectory": STRAIGHT},
        {"trajectory": STILL},
        {"trajectory": {"kind": "circle"}, "duration_s": 3.0},
        {"imu": {"velocity": {"sigma": 2.0}, "angular_velocity": {"sigma": 0.3}}},
        {"imu": {"velocity": {"sigma": 0.0}, "angular_velocity": {"sigma": 0.0}}},
        {"trajectory": STRAIGHT, "imu": {"angular_velocity": {"bias_sigma": 0.05}}},
        {"trajectory": STRAIGHT, "told": {"rotation_error_deg": [1.0, -1.0, 1.0]}},
        {"camera": {"sigma_px": 3.0, "outliers": {"share": 0.3}}},
    ],
    ids=lambda changes: str(changes) or "plain",
)
def test_a_generated_file_is_read_as_it_stands_whatever_the_scene(tmp_path, changes, seed):
    box = {"kind": "box", "count": 80, "size_m": [30.0, 20.0, 4.0]}
    data = simulate(scene(PLAIN, landmarks=box, **changes), seed)
    write_npz(tmp_path / "d.npz", data)
    assert read_convention(tmp_path / "d.npz").chosen.name == "imu_T_cam/flu"
    again = read_npz(tmp_path / "d.npz")
    assert again.calibration.T_imu_cam.tobytes() == data.calibration.T_imu_cam.tobytes()


@pytest.mark.parametrize("trajectory", [STRAIGHT, STILL], ids=lambda t: t["kind"])
@pytest.mark.parametrize("stored", ["imu_T_cam/flu", "imu_T_cam/frd"])
def test_a_motion_without_turns_leaves_the_frame_as_given_and_says_so(tmp_path, trajectory, stored):
    a_scene = scene(trajectory=trajectory, landmarks={"kind": "box", "count": 80})
    convention = read_convention(written(tmp_path / "d.npz", a_scene, "imu_T_cam", stored))
    assert convention.chosen.name == "imu_T_cam/flu"
    assert not convention.clear
    assert "not clearly" in convention.note
    assert "imu_T_cam/frd" in convention.note
    assert "--imu-frame flu|frd" in convention.note
    assert convention.note.startswith("Warning: ")
    assert "how the camera is turned" in convention.note


def test_a_drive_that_hardly_turns_cannot_tell_where_the_camera_stands(tmp_path):
    """In 2019's dialect the two readings with the right rotation differ by the lever arm alone."""
    a_scene = scene(
        trajectory={"kind": "straight", "speed_mps": 2.0, "roll_deg": 3.0, "pitch_deg": 3.0},
        landmarks={"kind": "box", "count": 300, "size_m": [160.0, 60.0, 10.0]},
        rig={"depth_m": [30.0, 80.0]},
        imu={"velocity": {"sigma": 0.01}, "angular_velocity": {"sigma": 1e-4}},
    )
    convention = read_convention(written(tmp_path / "d.npz", a_scene, "cam_T_imu", "mixed/flu"))
    assert not convention.clear
    assert "where the camera stands" in convention.note
    assert convention.chosen.name in ("cam_T_imu/flu", "mixed/flu")
    assert "turn by up to 0." in convention.note


def test_rates_as_noisy_as_the_turns_lead_to_no_wrong_reading(tmp_path):
    """In 12 s of straight road at 0.05 rad/s of noise, a camera behind the IMU undoes a part of it.

    The IMU frame that is not the claimed one shows all the same, by the frames together.
    """
    chosen = {"2019": [], "2022": [], "2022-as-distributed": []}
    for seed in range(1, 6):
        data = drive(0.1, 0.05, 0.3, seconds=12.0, seed=seed)
        for dialect, found in chosen.items():
            path = write_bare(tmp_path / "d.npz", data, dialect)
            found.append(read_convention(path).chosen.name)
    assert chosen["2019"] == 5 * ["cam_T_imu/flu"]
    assert chosen["2022"] == 5 * ["imu_T_cam/flu"]
    assert chosen["2022-as-distributed"].count("imu_T_cam/frd") >= 4


@pytest.mark.parametrize(
    ("frames", "method"), [(1, "exact"), (9, "exact"), (EXACT, "exact"), (200, "asymptotic")]
)
def test_the_chance_of_less_is_that_of_wilcoxon(frames, method):
    rng = np.random.default_rng(frames)
    errors, others = rng.exponential(1.0, frames), rng.exponential(1.3, frames)
    for one, other in ((errors, others), (others, errors)):
        expected = wilcoxon(one, other, alternative="less", method=method).pvalue
        assert chance_of_less(one, other) == pytest.approx(expected, rel=1e-6)


def test_frames_that_are_alike_or_far_off_in_both_show_nothing():
    alike, off = np.array([1.0, np.inf, 2e3]), np.array([1.0, np.inf, 5e3])
    assert chance_of_less(alike, off) == chance_of_less(off, alike) == 1.0


@pytest.mark.parametrize(("frames", "clear"), [(13, False), (14, True)])
def test_fourteen_of_fourteen_frames_are_enough(frames, clear):
    """Thirteen would be better by chance once in 8,192 times: more often than is allowed."""
    errors = np.random.default_rng(frames).exponential(1.0, frames)
    chance = chance_of_less(errors, errors + 0.1)
    assert chance == pytest.approx(0.5**frames)
    assert (chance < FALSE_ALARM) == clear


def test_by_how_much_the_chosen_reading_wins_is_said(tmp_path):
    convention = read_convention(written(tmp_path / "d.npz", scene(), "imu_T_cam", "imu_T_cam/frd"))
    chosen = convention.chosen
    second = min((r for r in convention.readings if r is not chosen), key=lambda r: r.error_px)
    said = f"{second.error_px / chosen.error_px:.1f} times nearer than {second.name}"
    assert said in convention.note
    better = np.count_nonzero(chosen.frame_errors_px < second.frame_errors_px)
    assert f"nearer in {better} of 50 frames" in convention.note


@pytest.mark.parametrize("trajectory", [STRAIGHT, STILL], ids=lambda t: t["kind"])
@pytest.mark.parametrize("stored", ["2025", "2025-as-distributed"])
def test_of_the_four_readings_of_2025_those_that_no_turn_tells_apart_are_named(
    tmp_path, trajectory, stored
):
    data = simulate(scene(trajectory=trajectory, landmarks={"kind": "box", "count": 80}))
    write_npz(tmp_path / "d.npy", data, Dialect.named(stored))
    convention = read_convention(tmp_path / "d.npy")
    right = {"2025": "cam_T_imu/flu", "2025-as-distributed": "imu_T_cam/flu/regular"}[stored]
    # where the right camera stands speaks for one of the four, even where no motion does
    assert convention.chosen.name == convention.readings[0].name == right
    assert {reading.name for reading in convention.readings} == {
        *("cam_T_imu/flu", "cam_T_imu/flu/regular"),
        *("imu_T_cam/flu", "imu_T_cam/flu/regular"),
    }
    # as distributed, two of them differ by a lever arm alone, which takes turns to be seen
    assert convention.clear == (trajectory is STRAIGHT and stored == "2025")
    assert convention.clear or "--camera-axes optical|regular" in convention.note


def test_too_few_frames_to_be_sure_leave_the_frame_as_given(tmp_path):
    """Ten frames: all could be better by chance once in a thousand times."""
    path = written(tmp_path / "d.npz", scene(duration_s=1.0), "imu_T_cam", "imu_T_cam/frd")
    convention = read_convention(path)
    assert convention.chosen.name == "imu_T_cam/flu"
    assert not convention.clear


def test_readings_that_mean_the_same_matrix_are_no_rivals(tmp_path):
    """Without a lever arm `mixed` and `cam_T_imu` are one."""
    a_scene = scene(rig={"imu_cam": {"translation_m": [0, 0, 0]}})
    path = written(tmp_path / "d.npz", a_scene, "cam_T_imu", "cam_T_imu/flu")
    convention = read_convention(path)
    assert convention.clear
    assert convention.chosen.name == "cam_T_imu/flu"


def test_what_the_caller_says_overrules_the_data(tmp_path):
    path = written(tmp_path / "d.npz", scene(), "imu_T_cam", "imu_T_cam/flu")
    T = scene().rig.T_imu_cam
    data = read_npz(path, imu_frame="frd", extrinsics="cam_T_imu")
    np.testing.assert_allclose(data.calibration.T_imu_cam, FRD @ np.linalg.inv(T), atol=1e-12)
    assert any("read as cam_T_imu/frd, as asked" in note for note in data.notes)
    data = read_npz(path, imu_frame="frd")
    assert any("read as " in note and "/frd" in note for note in data.notes)
    np.testing.assert_allclose(read_npz(path, imu_frame="flu").calibration.T_imu_cam, T)


def test_a_file_without_features_keeps_what_its_key_says(tmp_path):
    path = written(tmp_path / "d.npz", scene(), "cam_T_imu", "cam_T_imu/flu")
    with np.load(path) as file:
        arrays = {key: file[key] for key in file if key != "features"}
    np.savez_compressed(path, **arrays)
    convention = read_convention(path)
    assert convention.chosen.name == "cam_T_imu/flu"
    assert not convention.clear
    assert np.isnan(convention.chosen.error_px)
    np.testing.assert_allclose(
        read_npz(path).calibration.T_imu_cam, scene().rig.T_imu_cam, atol=1e-12
    )


def predicted(data, i, twist):
    """The median error of a frame, feature by feature, with matrices written out, or None."""
    rig, T = data.calibration.rig, data.calibration.T_imu_cam
    vx, vy, vz, x, y, z = twist
    hat = np.array([[0, -z, y, vx], [z, 0, -x, vy], [-y, x, 0, vz], [0, 0, 0, 0]])
    step = np.linalg.inv(T) @ expm(-hat * (data.times_s[i + 1] - data.times_s[i])) @ T
    before = dict(zip(data.frame(i).ids, data.frame(i).pixels, strict=True))
    errors = []
    for j, after in zip(data.frame(i + 1).ids, data.frame(i + 1).pixels, strict=True):
        if j in before:
            uL, vL, uR, vR = before[j]
            depth = rig.fx_px * rig.baseline_m / (uL - uR)
            p = (step @ [*(depth * np.linalg.inv(rig.K) @ [uL, (vL + vR) / 2, 1]), 1])[:3]
            errors.append(np.linalg.norm((rig.K @ p / p[2])[:2] - after[:2]))
    return np.median(errors) if errors else None


@pytest.mark.parametrize("laps", [1, 3])
def test_errors_are_those_of_a_plain_prediction_with_the_better_of_two_twists(tmp_path, laps):
    silent = {"velocity": {"sigma": 0.01}, "angular_velocity": {"sigma": 0.001}}
    a_scene = scene(
        duration_s=4.0, trajectory={"laps": laps}, imu=silent | {"twist": "instantaneous"}
    )
    data = simulate(a_scene)
    write_npz(tmp_path / "d.npz", data)
    got = read_convention(tmp_path / "d.npz").readings[0].frame_errors_px
    samples = np.concatenate([data.linear_velocity, data.angular_velocity], axis=1)
    both = [
        [e for i, u in enumerate(twists) if (e := predicted(data, i, u)) is not None]
        for twists in (samples[:-1], (samples[:-1] + samples[1:]) / 2)
    ]
    np.testing.assert_allclose(got, min(both, key=np.median), rtol=1e-7)
    assert np.median(both[1]) < np.median(both[0])


def test_a_reading_that_puts_features_behind_the_camera_has_no_finite_error():
    """Even where the point lies on the optical axis, whose pixel would be the same behind."""
    back = np.tile(np.eye(4), (2, 1, 1, 1))
    back[..., 2, 3] = -20.0
    rig = simulate(scene(duration_s=0.2)).calibration.rig
    motion = Motion(
        rig=rig,
        steps=back,
        start=np.array([0, 1]),
        points=np.array([[0.0, 0.0, 5.0]]),
        next_px=np.array([[rig.cx_px, rig.cy_px]]),
        fastest=np.array([True]),
        turns=np.array([True]),
    )
    assert motion.prediction_errors(np.eye(4)).tolist() == [np.inf]


@real
def test_the_file_of_2022_means_an_imu_frame_with_y_right_and_z_down():
    convention = read_convention(REAL / "2022/03.npz")
    errors = {reading.name: reading.error_px for reading in convention.readings}
    assert convention.chosen.name == "imu_T_cam/frd"
    assert convention.clear
    assert errors["imu_T_cam/frd"] < 2.5
    assert errors["imu_T_cam/flu"] > 20


@real
def test_the_file_of_2019_mixes_a_rotation_and_a_position():
    convention = read_convention(REAL / "2019/0020.npz")
    errors = {reading.name: reading.error_px for reading in convention.readings}
    assert convention.chosen.name == "mixed/flu"
    assert convention.clear
    assert errors["mixed/flu"] < 0.75 * errors["cam_T_imu/flu"]
