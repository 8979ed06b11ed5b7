"""What a verb is pointed at, and which options go with it."""

import numpy as np
import pytest

from simbench.errors import DatasetError, InputError
from simbench.filters import resolve
from simbench.mcap import read_dataset_mcap, read_run_mcap, record_to
from simbench.metrics import metrics
from simbench.npz import read_npz, write_npz
from simbench.outputs import write_dataset
from simbench.poses import read_poses, write_tum
from simbench.run import run
from simbench.source import Kind, Told, kind_of, open_source

SCENE = """
name: small
duration_s: 1.0
rate_hz: 5.0
landmarks: {kind: box, count: 10}
"""


@pytest.fixture
def files(tmp_path):
    """The same dataset as a scene, a dataset and a recording, and a trajectory, by kind."""
    scene = tmp_path / "small.yaml"
    scene.write_text(SCENE)
    dataset = open_source(scene)
    npz, mcap = write_dataset(dataset, tmp_path)
    write_tum(tmp_path / "small.tum", dataset.times_s, dataset.truth.T_world_imu)
    return dict(zip(Kind, (scene, npz, mcap, tmp_path / "small.tum"), strict=True))


@pytest.mark.parametrize("kind", Kind)
def test_a_kind_is_told_by_its_content(files, kind, tmp_path):
    assert kind_of(files[kind]) is kind
    if kind in (Kind.DATASET, Kind.RECORDING):
        renamed = tmp_path / "renamed.bin"
        renamed.write_bytes(files[kind].read_bytes())
        assert kind_of(renamed) is kind


def test_scene_dataset_and_recording_are_one_dataset(files):
    datasets = [open_source(files[k]) for k in (Kind.SCENARIO, Kind.DATASET, Kind.RECORDING)]
    for other in datasets[1:]:
        assert np.array_equal(other.times_s, datasets[0].times_s)
        assert np.array_equal(other.sightings.pixels, datasets[0].sightings.pixels)
        assert np.array_equal(other.prior.T_world_imu, datasets[0].prior.T_world_imu)


def test_a_gate_is_overruled(files):
    assert open_source(files[Kind.DATASET], Told(gate=0.9)).gate == 0.9
    gated = Told(overrides=("filter.gate=0.5",))
    assert open_source(files[Kind.SCENARIO], gated).gate == 0.5
    off = Told(overrides=gated.overrides, gate="none")
    assert open_source(files[Kind.SCENARIO], off).gate is None


@pytest.mark.parametrize(
    ("kind", "told", "option"),
    [
        (Kind.DATASET, Told(seed=1), "--seed"),
        (Kind.RECORDING, Told(overrides=("a=b",)), "--set"),
        (Kind.RECORDING, Told(noise_pixel_px=1.0), "--noise-pixel-px"),
        (Kind.SCENARIO, Told(imu_frame="flu"), "--imu-frame"),
    ],
)
def test_an_option_without_effect_is_refused(files, kind, told, option):
    with pytest.raises(InputError, match=f"{option} goes with a"):
        open_source(files[kind], told)


def test_a_trajectory_is_no_source_and_says_how_to_become_one(files):
    with pytest.raises(DatasetError, match="kind: file"):
        open_source(files[Kind.TRAJECTORY])


def test_what_is_not_there_is_said(tmp_path):
    with pytest.raises(InputError, match=r"nothing\.yaml: expected a file"):
        open_source(tmp_path / "nothing.yaml")


def test_readers_and_writers_take_a_path_as_text(tmp_path):
    scene = tmp_path / "small.yaml"
    scene.write_text(SCENE)
    dataset = open_source(str(scene))
    npz, mcap, tum = (f"{tmp_path}/small.{kind}" for kind in ("npz", "mcap", "tum"))
    write_npz(npz, dataset)
    with record_to(mcap, dataset, "slam") as recorder:
        record = run(dataset, resolve("slam"), on_step=recorder.step)
        recorder.finish(record, metrics(record))
    write_tum(tum, dataset.times_s, record.T_world_imu)
    for read in (read_npz(npz), read_dataset_mcap(mcap), read_run_mcap(mcap).record.dataset):
        assert np.array_equal(read.times_s, dataset.times_s)
    assert len(read_poses(tum).Ts_world_imu) == len(dataset)
