"""One file into another: what comes through, what is said to be lost, and what is refused."""

import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from simbench.cli import main
from simbench.convert import convert, target_of
from simbench.errors import InputError
from simbench.filters import resolve
from simbench.info import info
from simbench.mcap import read_dataset_mcap, read_run_mcap, record_to, summary, write_dataset_mcap
from simbench.metrics import metrics
from simbench.npz import Dialect, read_npz, write_npz
from simbench.poses import Format, read_poses, write_tum
from simbench.run import run
from simbench.sensors import simulate
from simbench.source import Kind, Told
from tests.simbench.scenes import RICH, differences, scene

REAL = Path(__file__).parents[3] / "shared/data"
real = pytest.mark.skipif(not REAL.is_dir(), reason="the real files are not beside the project")
SCENE = "name: small\nduration_s: 1.0\nlandmarks: {kind: box, count: 10}\n"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A dataset, a run over it, and a directory with all kinds of files made from them."""
    path = tmp_path_factory.mktemp("recorded")
    dataset = simulate(scene(RICH))
    with record_to(path / "run.mcap", dataset, "slam") as recorder:
        record = run(dataset, resolve("slam"), name="slam", on_step=recorder.step)
        recorder.finish(record, metrics(record))
    write_dataset_mcap(path / "data.mcap", dataset)
    write_npz(path / "data.npz", dataset)
    write_tum(path / "data.tum", dataset.times_s, dataset.truth.T_world_imu)
    (path / "small.yaml").write_text(SCENE)
    return path, dataset, record


def same_beliefs(a, b):
    return all(
        x.belief.T_world_imu.tobytes() == y.belief.T_world_imu.tobytes()
        and x.belief.pose_covariance.tobytes() == y.belief.pose_covariance.tobytes()
        for x, y in zip(a.steps, b.steps, strict=True)
    )


@pytest.mark.parametrize("process_noise", ["twist", "additive"])
def test_a_run_from_a_recording_or_a_file_is_that_from_the_scene_to_the_last_bit(
    tmp_path, process_noise
):
    dataset = simulate(scene(RICH, filter={"process_noise": process_noise, "gate": 0.999}))
    write_dataset_mcap(tmp_path / "a.mcap", dataset)
    convert(tmp_path / "a.mcap", tmp_path / "b.npz")
    convert(tmp_path / "b.npz", tmp_path / "c.mcap")
    records = [
        run(each, resolve("slam"))
        for each in (
            dataset,
            read_dataset_mcap(tmp_path / "a.mcap"),
            read_npz(tmp_path / "b.npz"),
            read_dataset_mcap(tmp_path / "c.mcap"),
        )
    ]
    assert len(records[0].final.ids) > 10
    for other in records[1:]:
        assert same_beliefs(records[0], other)
        for name in ("ids", "landmarks", "landmark_covariances"):
            assert not differences(getattr(records[0].final, name), getattr(other.final, name))


@pytest.mark.parametrize("dialect", ["2019", "2021", "2022-as-distributed", "2025", "2024"])
def test_a_dataset_becomes_one_of_another_dialect_and_back(recorded, tmp_path, dialect):
    path, dataset, _ = recorded
    there = tmp_path / f"there{Dialect.named(dialect).suffix}"
    done = convert(path / "data.npz", there, dialect=dialect)
    assert done.read is Kind.DATASET
    assert done.written.startswith({"2024": "2022"}.get(dialect, dialect[:4]))
    assert any("features" in line for line in done.lost) == (dialect == "2021")
    convert(there, tmp_path / "back.npz")
    back = read_npz(tmp_path / "back.npz")
    assert not differences(back.truth, dataset.truth)
    assert not differences(back.noise, dataset.noise)
    np.testing.assert_allclose(
        back.calibration.T_imu_cam, dataset.calibration.T_imu_cam, atol=1e-15
    )
    if dialect != "2021":
        assert not differences(back.sightings, dataset.sightings)


def test_what_readers_divide_by_is_changed_and_said(recorded, tmp_path):
    _, dataset, _ = recorded
    pixels, rates = dataset.sightings.pixels.copy(), dataset.angular_velocity.copy()
    (full, *_) = np.flatnonzero((pixels != -1).all(axis=1))
    pixels[full, 2], rates[4] = pixels[full, 0], 0
    write_dataset_mcap(
        tmp_path / "a.mcap",
        replace(
            dataset,
            sightings=replace(dataset.sightings, pixels=pixels),
            angular_velocity=rates,
        ),
    )
    lost = convert(tmp_path / "a.mcap", tmp_path / "a.npz").lost
    assert [line[:28] for line in lost] == [
        "1 rates of exactly zero, whi",
        "1 disparities of exactly zer",
    ]


def test_the_run_of_a_recording_is_not_in_its_dataset_and_that_is_said(recorded, tmp_path):
    path, dataset, _ = recorded
    done = convert(path / "run.mcap", tmp_path / "a.npz")
    assert done.lost == ("the run of slam: its estimates, covariances and metrics",)
    assert not differences(read_npz(tmp_path / "a.npz").sightings, dataset.sightings)
    assert convert(path / "data.mcap", tmp_path / "a.npz").lost == ()


# trajectories


@pytest.mark.parametrize("kind", Format)
@pytest.mark.parametrize("source", ["data.npz", "data.mcap", "run.mcap"])
def test_the_poses_of_data_become_a_trajectory(recorded, tmp_path, source, kind):
    path, dataset, record = recorded
    target = tmp_path / {"tum": "a.tum", "kitti": "a.kitti", "euroc": "a.csv"}[kind]
    lost = convert(path / source, target).lost
    of_run = source == "run.mcap"
    assert lost[0] == f"all but the {'estimated' if of_run else 'true'} poses at the frames"
    assert ("the times" in lost) == (kind is Format.KITTI)
    poses = read_poses(target)
    expected = record.T_world_imu if of_run else dataset.truth.T_world_imu
    np.testing.assert_allclose(poses.Ts_world_imu, expected, rtol=0, atol=1e-14)
    if kind is not Format.KITTI:
        np.testing.assert_array_equal(poses.times_s, dataset.times_s)
    if of_run:
        convert(path / source, target, which="truth")
        truth = read_poses(target).Ts_world_imu
        np.testing.assert_allclose(truth, dataset.truth.T_world_imu, rtol=0, atol=1e-14)


def test_trajectories_become_each_other_and_what_is_lost_is_said(recorded, tmp_path):
    path, dataset, _ = recorded
    assert convert(path / "data.tum", tmp_path / "a.csv").lost == ()
    assert convert(tmp_path / "a.csv", tmp_path / "b.tum").lost == ()
    assert (tmp_path / "b.tum").read_text() == (path / "data.tum").read_text()
    assert convert(tmp_path / "a.csv", tmp_path / "a.txt", dialect="kitti").lost == ("the times",)
    convert(tmp_path / "a.txt", tmp_path / "c.tum", rate_hz=10.0)
    np.testing.assert_allclose(
        read_poses(tmp_path / "c.tum").times_s, np.arange(len(dataset)) / 10, rtol=1e-15
    )
    (tmp_path / "fine.tum").write_text("0.0000000001 0 0 0 0 0 0 1\n")
    lost = convert(tmp_path / "fine.tum", tmp_path / "fine.csv").lost
    assert lost == ("the digits of times below a nanosecond",)
    (tmp_path / "wide.csv").write_text("#t\n5,0,0,0,1,0,0,0,9,9,9\n6,0,0,0,1,0,0,0,9,9,9")
    assert convert(tmp_path / "wide.csv", tmp_path / "w.tum").lost == (
        "the columns beyond the pose",
    )


def evo(*arguments, home):
    """What a program of evo says; settings go to a home of its own."""
    pytest.importorskip("evo")
    done = subprocess.run(
        [Path(sys.executable).parent / arguments[0], *map(str, arguments[1:])],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"HOME": str(home), "MPLBACKEND": "agg"},
        timeout=120,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.parametrize(("kind", "suffix"), [("tum", "tum"), ("kitti", "kitti"), ("euroc", "csv")])
def test_evo_takes_each_format(recorded, tmp_path, kind, suffix):
    path, dataset, _ = recorded
    convert(path / "data.mcap", tmp_path / f"a.{suffix}")
    said = evo("evo_traj", kind, tmp_path / f"a.{suffix}", home=tmp_path)
    length = np.linalg.norm(np.diff(dataset.truth.T_world_imu[:, :3, 3], axis=0), axis=1).sum()
    assert f"{len(dataset)} poses, {length:.3f}m path length" in said


def test_evo_reads_the_recording_itself_and_finds_the_same_error(recorded, tmp_path):
    path, _, record = recorded
    topics = ("/ground_truth/pose", "/estimate/pose")
    said = evo("evo_ape", "mcap", path / "run.mcap", *topics, home=tmp_path)
    rmse = float(re.search(r"rmse\s+([\d.]+)", said)[1])
    assert rmse == pytest.approx(metrics(record)["ate_rmse_m"], abs=1e-6)


# recordings of killed runs


def test_what_a_killed_run_left_is_finished_and_says_that_it_was_cut_short(recorded, tmp_path):
    path, dataset, record = recorded
    whole, partial = (path / "run.mcap").read_bytes(), tmp_path / "run.mcap.partial"
    target = tmp_path / "run.mcap"
    for share in (0.5, 0.6, 0.7):
        cut = whole[: int(share * len(whole))]
        partial.write_bytes(cut)
        assert info(partial)["recording"]["finished"] is False
        done = convert(partial, target)
        assert "the run was cut short" in done.lost[0]
        assert done.lost[0] in convert(partial, tmp_path.with_name("cut.npz")).lost
        assert partial.read_bytes() == cut
        assert sorted(p.name for p in tmp_path.iterdir()) == ["run.mcap", "run.mcap.partial"]
        assert summary(target).finished
        assert summary(target).counts == summary(partial).counts
        with AnyReader([target]) as reader:
            counted = sum(1 for _ in reader.messages())
        assert counted == sum(summary(target).counts.values())
        kept = read_run_mcap(target).record
        frames = len(kept.dataset)
        assert 10 <= frames < len(dataset)
        assert any(f"interrupted after frame {frames - 1}" in n for n in info(target)["notes"])
        np.testing.assert_array_equal(kept.dataset.times_s, dataset.times_s[:frames])
        np.testing.assert_allclose(
            kept.T_world_imu, record.T_world_imu[:frames], rtol=0, atol=1e-14
        )


def test_a_recording_of_less_than_a_second_is_nothing_to_finish(recorded, tmp_path):
    whole = (recorded[0] / "run.mcap").read_bytes()
    (tmp_path / "a.partial").write_bytes(whole[: len(whole) // 20])
    with pytest.raises(InputError, match="before its first second was written"):
        convert(tmp_path / "a.partial", tmp_path / "a.mcap")
    assert [p.name for p in tmp_path.iterdir()] == ["a.partial"]


# what is refused


@pytest.mark.parametrize(
    ("source", "target", "options", "message"),
    [
        ("small.yaml", "a.npz", {}, "simbench generate .*small.yaml"),
        ("data.tum", "a.npz", {}, "a trajectory holds no readings"),
        ("data.tum", "a.mcap", {}, "kind: file"),
        ("data.npz", "a.txt", {}, r"TUM or KITTI\? Say --dialect tum"),
        ("data.npz", "a.png", {}, r"expected one of the suffixes \.npz, .* got '\.png'"),
        ("data.npz", "a", {}, "a bag directory is made of a recording"),
        ("data.npz", "a.npz", {"dialect": "2025"}, r"ends in \.npy, got '\.npz'"),
        ("data.npz", "a.npy", {"dialect": "2022"}, r"ends in \.npz, got '\.npy'"),
        ("data.npz", "a.csv", {"dialect": "tum"}, r"ends in \.tum or \.txt, got '\.csv'"),
        ("data.npz", "a.npz", {"dialect": "mcap"}, "Expected a dialect: a year from 2019"),
        ("data.npz", "data.npz", {}, "expected another file than the source"),
        ("data.npz", "a.tum", {"which": "estimate"}, "holds no estimate; `simbench run"),
        ("data.mcap", "a.tum", {"which": "estimate"}, "holds no estimate"),
        ("data.npz", "a.mcap", {"which": "truth"}, "--poses goes with"),
        ("data.npz", "a.tum", {"rate_hz": 10.0}, "--rate-hz goes with"),
        ("data.tum", "a.csv", {"rate_hz": 10.0}, "--rate-hz goes with poses without times"),
        ("run.mcap", "a.mcap", {"told": Told(imu_frame="flu")}, "--imu-frame goes with a dataset"),
        ("run.mcap", "a.tum", {"told": Told(imu_frame="flu")}, "--imu-frame goes with a dataset"),
        ("data.tum", "a.csv", {"told": Told(camera_axes="regular")}, "--camera-axes goes with"),
        ("none.npz", "a.csv", {}, "none.npz: expected a file that can be read"),
    ],
)
def test_what_makes_no_sense_is_refused_with_one_message_and_no_file(
    recorded, tmp_path, source, target, options, message
):
    path = recorded[0]
    there = path / target if target == "data.npz" else tmp_path / target
    before = there.read_bytes() if there.exists() else None
    with pytest.raises(InputError, match=message):
        convert(path / source, there, **options)
    assert (there.read_bytes() if there.exists() else None) == before
    assert not list(tmp_path.iterdir())


def test_poses_without_times_want_a_rate(recorded, tmp_path):
    convert(recorded[0] / "data.tum", tmp_path / "a.kitti")
    with pytest.raises(InputError, match="--rate-hz 10"):
        convert(tmp_path / "a.kitti", tmp_path / "a.tum")


def test_a_drive_of_which_nobody_knows_the_truth_has_no_trajectory(recorded, tmp_path):
    write_npz(tmp_path / "a.npz", replace(recorded[1], truth=None))
    with pytest.raises(InputError, match=r"nobody knows the true poses .*`simbench run"):
        convert(tmp_path / "a.npz", tmp_path / "a.tum")


def test_suffixes_say_what_a_file_is_to_be():
    assert target_of(Path("a.csv"), None) is Format.EUROC
    assert target_of(Path("a.txt"), "kitti") is Format.KITTI
    assert str(target_of(Path("a.npy"), "2025-as-distributed").meaning) == "imu_T_cam/flu/regular"


# the command line


def test_the_verb_prints_what_is_lost(recorded, tmp_path, capsys):
    arguments = ["convert", recorded[0] / "data.npz", tmp_path / "a.npz", "--dialect", "2021"]
    assert main([*map(str, arguments), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["lost"] == ["the features: files of 2021 have none"]
    assert said["files"] == [str(tmp_path / "a.npz")]
    assert main(["convert", str(tmp_path / "a.npz"), str(tmp_path / "a.png")]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_generate_says_what_is_not_in_the_file(recorded, tmp_path, capsys):
    scene_file = str(recorded[0] / "small.yaml")
    assert main(["generate", scene_file, "--dialect", "2021", "--out", str(tmp_path)]) == 0
    assert "Not in small.npz: the features" in capsys.readouterr().err


@pytest.mark.parametrize(("dialect", "name"), [("2019", "small.npz"), ("2025", "small.npy")])
def test_generate_writes_the_dialect_that_it_is_told(recorded, tmp_path, capsys, dialect, name):
    arguments = ["generate", recorded[0] / "small.yaml", "--dialect", dialect, "--out", tmp_path]
    assert main([*map(str, arguments)]) == 0
    capsys.readouterr()
    assert info(tmp_path / name)["dialect"] == dialect
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted([name, "small.mcap"])
    assert main([*map(str, arguments[:2]), "--dialect", "1999", "--out", str(tmp_path)]) == 2
    assert "Expected a dialect" in capsys.readouterr().err


# real files


@real
@pytest.mark.parametrize(
    ("name", "dialect"),
    [
        ("2019/0020", "2019-as-distributed"),
        pytest.param("2022/03", "2022-as-distributed", marks=pytest.mark.slow),
    ],
)
def test_a_real_file_comes_through_as_it_was_distributed(tmp_path, name, dialect):
    convert(REAL / f"{name}.npz", tmp_path / "a.npz", dialect=dialect)
    with np.load(REAL / f"{name}.npz") as given, np.load(tmp_path / "a.npz") as made:
        for key in given.files:
            if "T_" in key:  # its rotation has six digits, and is made exact
                np.testing.assert_allclose(made[key], given[key], rtol=0, atol=1e-7)
            else:
                assert made[key].tobytes() == given[key].tobytes(), key


@real
def test_a_real_file_in_the_dialect_of_2025_is_read_as_the_same_drive(tmp_path):
    convert(REAL / "2019/0020.npz", tmp_path / "a.npy", dialect="2025-as-distributed")
    given, made = read_npz(REAL / "2019/0020.npz"), read_npz(tmp_path / "a.npy")
    assert not differences(made.sightings, given.sightings)
    np.testing.assert_allclose(
        made.calibration.T_imu_cam, given.calibration.T_imu_cam, rtol=0, atol=1e-14
    )
    (chosen,) = [c for c in info(tmp_path / "a.npy")["conventions"] if c["chosen"]]
    assert chosen["name"] == "imu_T_cam/flu/regular"
    assert any("clearly: " in note and "not clearly" not in note for note in made.notes)
