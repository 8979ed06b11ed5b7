"""The command line as its user meets it: what it writes, prints, and says to mistakes."""

import json
import os
import resource
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from simbench.cli import main

SCENE = """\
name: small
seed: 5
duration_s: 2.0
trajectory: {kind: hover, sway_m: [0.3, 0.2, 0.1]}
landmarks: {kind: box, count: 15, size_m: [4.0, 6.0, 3.0], center_m: [8.0, 0.0, 1.0]}
"""
FILTERS = '''\
"""Filters that a user might hand over."""

from vislam.filters import DeadReckoning, EkfSlam

number = 3


def fine(task):
    return EkfSlam(task)


class Raises(DeadReckoning):
    def update(self, frame):
        if frame.time_s >= 0.2:
            raise ZeroDivisionError("a planted mistake")
        return super().update(frame)


def nonsense(task):
    return "no filter"
'''
SIMBENCH = [sys.executable, "-c", "import sys; from simbench.cli import main; sys.exit(main())"]
METRICS = [
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
METRICS += [f"smoothed_{name}" for name in METRICS[8:15]]

pytestmark = pytest.mark.usefixtures("here")


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A directory with a small scene and a module of filters, to work in."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small.yaml").write_text(SCENE)
    (tmp_path / "filters_of_mine.py").write_text(FILTERS)
    yield tmp_path
    sys.modules.pop("filters_of_mine", None)


@pytest.fixture(scope="session")
def generated(tmp_path_factory):
    """The files of the small scene, made once."""
    folder = tmp_path_factory.mktemp("generated")
    (folder / "small.yaml").write_text(SCENE)
    assert main(["generate", str(folder / "small.yaml"), "--out", str(folder)]) == 0
    return folder


def written(folder):
    return sorted(path.name for path in folder.iterdir()) if folder.exists() else []


def simbench(*arguments, **options):
    """The verb in a process of its own."""
    return subprocess.run(
        [*SIMBENCH, *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=120,
        **options,
    )


def refusal(capsys, *arguments):
    """What a verb says to what it cannot use: on standard error alone, and with status 2."""
    assert main(list(map(str, arguments))) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert "Traceback" not in err
    assert "Internal" not in err
    return err


# What it does


def test_generate_writes_a_dataset_and_a_recording_and_says_what_is_in_them(here, capsys):
    assert main(["generate", "small.yaml", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert written(here / "out") == ["small.mcap", "small.npz"]
    assert said["files"] == ["out/small.npz", "out/small.mcap"]
    assert (said["frames"], said["landmarks"], said["truth"]) == (21, 15, True)


def test_a_run_leaves_a_recording_metrics_one_trajectory_and_pictures(here, capsys):
    assert main(["run", "small.yaml", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert list(said) == METRICS
    assert {name for name, v in said.items() if v is None} == set(METRICS[-7:])
    assert written(here / "out") == [
        "small.slam.consistency.png",
        "small.slam.errors.png",
        "small.slam.json",
        "small.slam.mcap",
        "small.slam.trajectory.png",
        "small.slam.tum",
        "small.trajectories.png",
    ]
    assert json.loads((here / "out/small.slam.json").read_text()) == said


def test_scene_dataset_and_recording_give_the_same_run(here, generated, capsys):
    said = []
    for source in (here / "small.yaml", generated / "small.npz", generated / "small.mcap"):
        assert main(["run", str(source), "--filter", "slam", "--json"]) == 0
        values = json.loads(capsys.readouterr().out)
        said.append({k: v for k, v in values.items() if k not in ("wall_s", "realtime_factor")})
    assert said[0] == said[1] == said[2]


def test_several_filters_give_a_list_and_one_picture_of_both(here, capsys):
    names = ["dead-reckoning", "filters_of_mine:fine"]
    options = [word for name in names for word in ("--filter", name)]
    assert main(["run", "small.yaml", *options, "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert [values["filter"] for values in said] == names
    assert [list(values) for values in said] == [METRICS, METRICS]
    assert said[0]["nis_mean_per_dof"] is None
    assert "small.filters_of_mine_fine.tum" in written(here / "out")
    assert "small.trajectories.png" in written(here / "out")


@pytest.mark.parametrize("name", ["small.yaml", "small.npz", "small.mcap"])
def test_info_describes_every_kind_of_file_in_one_json_value(generated, name, capsys):
    assert main(["info", str(generated / name), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert (
        said["kind"]
        == {"yaml": "scenario", "npz": "dataset", "mcap": "recording"}[name[-4:].lstrip(".")]
    )
    assert (said["frames"], said["rate_hz"], said["conventions"] != []) == (
        21,
        pytest.approx(10),
        name == "small.npz",
    )


def test_without_json_a_line_stands_for_each_value(generated, capsys):
    assert main(["info", str(generated / "small.npz")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert next(line.split() for line in lines if line.startswith("frames")) == ["frames", "21"]


@pytest.mark.parametrize(
    ("what", "first"),
    [("filters", "dead-reckoning"), ("trajectories", "hover"), ("landmarks", "box")],
)
def test_a_list_has_a_line_each_and_the_name_first(what, first, capsys):
    assert main(["list", what]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert first in [line.split()[0] for line in lines]
    assert main(["list", what, "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)) == len(lines)


def test_the_schema_admits_the_keys_of_a_scene(capsys):
    assert main(["list", "schema"]) == 0
    schema = json.loads(capsys.readouterr().out)
    assert {"name", "seed", "trajectory", "rig", "camera", "told"} <= set(schema["properties"])


def test_seed_run_and_set_change_the_data(capsys):
    def sightings(*options):
        assert main(["generate", "small.yaml", "--out", "o", *options]) == 0
        capsys.readouterr()
        return np.load("o/small.npz")["features"]

    plain = sightings()
    assert np.array_equal(plain, sightings("--seed", "5", "--run", "0"))
    for options in (["--seed", "6"], ["--run", "1"], ["--set", "camera.sigma_px=0.2"]):
        assert not np.array_equal(plain, sightings(*options))


# What it says to mistakes


@pytest.mark.parametrize("verb", ["generate", "run", "info"])
def test_a_missing_file_is_named(verb, capsys):
    assert "nothing.yaml: expected a file" in refusal(capsys, verb, "nothing.yaml")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("seed: [1,\n", "bad.yaml:2: expected YAML"),
        ("no scene\n", "bad.yaml:1: expected a mapping"),
        ("seed: 1\nseed: 2\n", "bad.yaml:2: seed"),
        ("seed: 1\nduration_s: long\n", "bad.yaml:2: duration_s: expected a number"),
        ("rate_hz: .nan\n", "rate_hz: expected a finite number"),
        ("rate_hz: .inf\n", "rate_hz: expected a finite number"),
        ("camera:\n  sigma_px: -1\n", "bad.yaml:2: camera.sigma_px: expected a number above 0"),
        ("imu: {velocity: {sigma: -1}}\n", "imu.velocity.sigma: expected a number of at least 0"),
        ("rig: {baseline_m: 0}\n", "rig.baseline_m: expected a number above 0"),
        (
            "trajectory: {kind: waypoints, points: [[0, 0, 0], [1, 0, 0]], times_s: [1, 0]}\n",
            "times_s",
        ),
        ("trajectory: {kind: file, path: gone.tum}\n", "gone.tum: expected a file"),
        ("landmarks: {kind: file, path: gone.csv}\n", "gone.csv: expected a file"),
        ("rig: {depth_m: [900, 901]}\n", "no landmark is ever seen"),
    ],
)
def test_a_scene_that_is_none_is_refused_with_its_place(here, text, message, capsys):
    (here / "bad.yaml").write_text(text)
    assert message in refusal(capsys, "generate", "bad.yaml")
    assert written(here / "out") == []


def test_every_fault_of_a_scene_is_told_at_once(here, capsys):
    (here / "bad.yaml").write_text("seed: -1\nrate_hz: 0\nrig: {baseline_m: -1}\n")
    assert len(refusal(capsys, "run", "bad.yaml").splitlines()) == 3


def rewritten(generated, target, **changes):
    """The dataset with some of its arrays replaced, or taken away."""
    with np.load(generated / "small.npz") as arrays:
        kept = {key: arrays[key] for key in arrays}
    kept = {k: v for k, v in (kept | changes).items() if v is not None}
    np.savez(target, **kept)


BROKEN = {
    "times stand still": ({"time_stamps": np.zeros((1, 21))}, "increas"),
    "times not finite": ({"time_stamps": np.full((1, 21), np.nan)}, "finite"),
    "fewer velocities than times": ({"linear_velocity": np.zeros((3, 20))}, "linear_velocity"),
    "no times": ({"time_stamps": None}, "time_stamps"),
    "no rigid motion": ({"imu_T_cam": np.diag([1.0, 2.0, 1.0, 1.0])}, "expected a rigid motion"),
    "no baseline": ({"b": np.array(0.0)}, "b"),
    "velocity not finite": ({"linear_velocity": np.full((3, 21), np.inf)}, "finite"),
    "words for numbers": ({"K": np.array("K")}, "K"),
    "a camera matrix of another shape": ({"K": np.eye(4)}, "(3, 3)"),
}


@pytest.mark.parametrize("fault", BROKEN)
def test_a_dataset_that_is_none_is_refused(here, generated, fault, capsys):
    changes, message = BROKEN[fault]
    rewritten(generated, here / "broken.npz", **changes)
    said = refusal(capsys, "run", "broken.npz")
    assert "broken.npz" in said
    assert message in said
    assert written(here / "out") == []


@pytest.mark.parametrize("name", ["small.npz", "small.mcap"])
@pytest.mark.parametrize("verb", ["run", "info"])
def test_a_file_without_its_beginning_or_its_end_is_refused(here, generated, name, verb, capsys):
    whole = (generated / name).read_bytes()
    for part in (b"", whole[:9], whole[9:]):
        (here / name).write_bytes(part)
        assert name in refusal(capsys, verb, name)


def test_a_truncated_dataset_is_refused(here, generated, capsys):
    whole = (generated / "small.npz").read_bytes()
    (here / "cut.npz").write_bytes(whole[: len(whole) // 2])
    assert "end is missing" in refusal(capsys, "run", "cut.npz")


@pytest.mark.parametrize("verb", ["generate", "run", "info"])
def test_a_directory_or_a_device_is_no_source(here, verb, capsys):
    refusal(capsys, verb, here)
    refusal(capsys, verb, "/dev/null")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--filter", "slamm"], "Did you mean slam?"),
        (["--filter", "nowhere_at_all:factory"], "No module named"),
        (["--filter", "filters_of_mine:absent"], "has no attribute"),
        (["--filter", "filters_of_mine:number"], "expected a callable"),
        (["--gate", "1"], "expected a probability"),
        (["--gate", "0"], "expected a probability"),
        (["--gate", "nan"], "expected a probability"),
        (["--seed", "-1"], "--seed"),
        (["--seed", str(2**63)], "--seed"),
        (["--run", str(2**63)], "--run"),
        (["--set", "camera.sigma=1"], "--set camera.sigma=1: camera.sigma: unknown key"),
        (["--set", "kamera.sigma_px=1"], "--set kamera.sigma_px=1: kamera: unknown key"),
        (["--set", "camera"], "expected key.path=value"),
        (["--imu-frame", "frd"], "--imu-frame goes with a dataset"),
        (["--noise-pixel-px", "1"], "--noise-pixel-px goes with a dataset"),
        (["--noise-pixel-px", "-1"], "--noise-pixel-px"),
        (["--nonsense"], "No such option"),
    ],
)
def test_an_option_that_makes_no_sense_is_refused(here, options, message, capsys):
    assert message in refusal(capsys, "run", "small.yaml", *options)
    assert written(here / "out") == []


@pytest.mark.parametrize(
    "options",
    [["--seed", "1"], ["--run", "0"], ["--set", "duration_s=1"], ["--most-scalars", "100"]],
    ids=lambda options: options[0],
)
def test_an_audit_of_the_built_in_scenes_takes_no_options_of_a_scene(options, capsys):
    said = refusal(capsys, "audit", "--filter", "slam", *options)
    assert f"{options[0]} goes with --scene" in said


def test_a_search_takes_no_seed_beyond_what_a_scene_may_have(capsys):
    assert "--seed" in refusal(capsys, "hunt", "--filter", "slam", "--seed", str(2**63))


@pytest.mark.parametrize("option", [["--seed", "1"], ["--run", "1"], ["--set", "seed=1"]])
@pytest.mark.parametrize("name", ["small.npz", "small.mcap"])
def test_options_of_a_scene_do_not_go_with_data(generated, name, option, capsys):
    said = refusal(capsys, "run", generated / name, *option)
    assert f"{option[0]} goes with a scenario" in said


def test_a_filter_that_raises_is_a_result_that_names_the_call(capsys):
    assert main(["run", "small.yaml", "--filter", "filters_of_mine:Raises"]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert "update 2 raised ZeroDivisionError: a planted mistake" in err
    assert "Traceback" not in err


def test_what_is_no_filter_is_a_result_too(capsys):
    assert main(["run", "small.yaml", "--filter", "filters_of_mine:nonsense"]) == 1
    said = capsys.readouterr().err
    assert "The filter failed: start gave what is no filter: str has no method predict" in said


def test_debug_shows_the_traceback():
    refused = simbench("run", "nothing.yaml", "--debug")
    assert refused.returncode == 2
    assert "Traceback" in refused.stderr
    assert "DatasetError" in refused.stderr


def test_a_file_where_the_directory_should_be_is_told(here, capsys):
    (here / "out").write_text("in the way")
    assert "out" in refusal(capsys, "generate", "small.yaml")
    assert "out" in refusal(capsys, "run", "small.yaml")
    assert (here / "out").read_text() == "in the way"


@pytest.mark.parametrize("verb", ["generate", "run"])
@pytest.mark.parametrize("kilobytes", [4, 40])
def test_a_full_disk_leaves_earlier_files_whole_and_nothing_half_written(here, verb, kilobytes):
    def full():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (kilobytes * 1024, kilobytes * 1024))

    (here / "out").mkdir()
    (here / "out/small.npz").write_text("earlier")
    said = simbench(verb, "small.yaml", preexec_fn=full, env=os.environ | {"MPLCONFIGDIR": "."})
    assert said.returncode == 2
    assert said.stdout == ""
    assert "Cannot write" in said.stderr
    assert "Traceback" not in said.stderr
    assert [name for name in written(here / "out") if name.endswith(".partial")] == []
    for path in (here / "out").iterdir():
        assert path.stat().st_size < kilobytes * 1024


def test_an_interrupt_in_the_middle_leaves_no_file_under_its_final_name(here):
    process = subprocess.Popen(
        [*SIMBENCH, "run", "small.yaml", "--set", "duration_s=600"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    partial = here / "out/small.slam.mcap.partial"
    for _ in range(600):
        if partial.exists() and partial.stat().st_size > 100_000:
            break
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out) == (130, "")
    assert "Interrupted" in err
    assert "Traceback" not in err
    assert set(written(here / "out")) <= {"small.slam.mcap.partial"}
