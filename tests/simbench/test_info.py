"""What is said of a file."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from simbench.dataset import Sightings
from simbench.errors import InputError
from simbench.info import describe, info
from simbench.npz import write_npz
from simbench.outputs import write_dataset
from simbench.poses import write_tum
from simbench.source import Kind, Told, open_source

SCENE = """
name: small
duration_s: 4.0
rate_hz: 5.0
trajectory: {kind: circle, radius_m: 4.0}
landmarks: {kind: box, count: 40}
camera: {half_missing: 0.2}
"""
SHARED = Path(__file__).parents[3] / "shared/data"


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    path = tmp_path_factory.mktemp("info")
    scene = path / "small.yaml"
    scene.write_text(SCENE)
    dataset = open_source(scene)
    npz, mcap = write_dataset(dataset, path)
    write_tum(path / "small.tum", dataset.times_s, dataset.truth.T_world_imu)
    return dict(zip(Kind, (scene, npz, mcap, path / "small.tum"), strict=True))


@pytest.mark.parametrize("kind", Kind)
def test_every_kind_is_described_in_json(files, kind):
    described = json.loads(json.dumps(info(files[kind]), allow_nan=False))
    assert described["kind"] == kind.value
    assert described["duration_s"] == pytest.approx(4.0)
    assert described["rate_hz"] == pytest.approx(5.0)
    assert {"conventions", "problems"} <= set(described)


def test_sizes_are_those_of_the_data(files):
    dataset = open_source(files[Kind.SCENARIO])
    described = describe(dataset)
    assert described["frames"] == len(dataset) == 21
    assert described["landmarks"] == 40
    assert described["sightings"] == len(dataset.sightings)
    assert described["told"]["sigma_px"] == dataset.noise.sigma_px.tolist()
    assert any("half of it is missing" in problem for problem in described["problems"])


def test_a_dataset_shows_every_reading_of_its_extrinsics(files):
    conventions = info(files[Kind.DATASET])["conventions"]
    chosen = [c["name"] for c in conventions if c["chosen"]]
    assert chosen == ["imu_T_cam/flu"]
    assert len(conventions) == 6


def test_a_recording_says_what_it_holds(files):
    recording = info(files[Kind.RECORDING])["recording"]
    assert recording["finished"]
    assert recording["counts"]["/twist"] == 21


@pytest.mark.parametrize(
    ("name", "dialect", "chosen"),
    [("2019/0020", "2019", "mixed/flu"), ("2022/03", "2022", "imu_T_cam/frd")],
)
def test_real_files_are_told_apart(name, dialect, chosen):
    path = SHARED / f"{name}.npz"
    if not path.exists():
        pytest.skip(f"{path} is not there")
    described = info(path)
    assert described["dialect"] == dialect
    assert [c["name"] for c in described["conventions"] if c["chosen"]] == [chosen]


def test_a_real_file_without_features_says_so():
    path = SHARED / "2021/03.npz"
    if not path.exists():
        pytest.skip(f"{path} is not there")
    described = info(path)
    assert [c["median_px"] for c in described["conventions"]] == [None] * 6
    assert not described["clear"]
    assert "no features" in described["problems"][0]
    assert any("nothing tells the readings apart" in note for note in described["notes"])


def test_a_single_pose_or_frame_has_no_rate(files, tmp_path):
    (tmp_path / "one.tum").write_text("0 0 0 0 0 0 0 1\n")
    assert info(tmp_path / "one.tum")["rate_hz"] is None
    many = open_source(files[Kind.DATASET])
    one = replace(
        many,
        times_s=many.times_s[:1],
        linear_velocity=many.linear_velocity[:1],
        angular_velocity=many.angular_velocity[:1],
        sightings=Sightings.from_frames([(many.frame(0).ids, many.frame(0).pixels)]),
        truth=None,
        imu=None,
    )
    write_npz(tmp_path / "one.npz", one)
    described = info(tmp_path / "one.npz")
    assert (described["frames"], described["duration_s"], described["rate_hz"]) == (1, 0, None)


@pytest.mark.parametrize(
    ("told", "count"),
    [
        ({"imu_frame": "frd"}, 3),
        ({"extrinsics": "cam_T_imu"}, 2),
        ({"imu_frame": "frd", "extrinsics": "mixed"}, 1),
    ],
)
def test_of_the_readings_that_were_asked_for_that_of_the_data_is_chosen(files, told, count):
    described = info(files[Kind.DATASET], Told(**told))
    assert len(described["conventions"]) == count
    (chosen,) = [c["name"] for c in described["conventions"] if c["chosen"]]
    assert set(told.values()) <= set(chosen.split("/"))
    assert any(f"are read as {chosen}" in note for note in described["notes"])


def test_whether_the_convention_is_clear_is_said_only_where_there_is_one(files):
    clear = {kind: info(files[kind])["clear"] for kind in Kind}
    assert clear == dict.fromkeys(Kind) | {Kind.DATASET: True}


def test_a_trajectory_has_no_convention_to_overrule(files):
    with pytest.raises(
        InputError, match=r"--imu-frame goes with a dataset, but .* is a trajectory"
    ):
        info(files[Kind.TRAJECTORY], Told(imu_frame="flu"))


def test_the_path_is_as_long_as_the_true_one_where_that_is_known(files):
    dataset = open_source(files[Kind.SCENARIO])
    true = np.linalg.norm(np.diff(dataset.truth.T_world_imu[:, :3, 3], axis=0), axis=1).sum()
    assert describe(dataset)["path_length_m"] == pytest.approx(true, rel=1e-12)
    untold = describe(replace(dataset, truth=None))["path_length_m"]
    assert untold == pytest.approx(true, rel=0.5)
    assert untold != pytest.approx(true, rel=1e-6)
