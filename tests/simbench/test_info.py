"""What is said of a file."""

import json
from pathlib import Path

import pytest

from simbench.info import describe, info
from simbench.outputs import write_dataset
from simbench.source import Kind, open_source
from simbench.tum import write_tum

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
    assert described["conventions"] == []
    assert "no features" in described["problems"][0]
