"""Every scene that ships: what its head says of it is true, in numbers."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from simbench.filters import resolve
from simbench.metrics import metrics, path_length
from simbench.run import run
from simbench.scenario import load
from simbench.sensors import simulate
from vislam.camera import Validity, triangulate, validity
from vislam.lie import so3

SCENES = Path(__file__).parents[1] / "scenarios"
#: Those on which code is judged keep the depth rule: sigma_depth / depth at birth at most 5 %.
OF_CONSISTENCY = ["circle", "corridor", "figure8", "helix", "hover", "two_laps"]


def data(name, seed=None):
    return simulate(load(SCENES / f"{name}.yaml"), seed=seed)


def measured(dataset, name="slam"):
    return metrics(run(dataset, resolve(name)))


def cut(dataset, key="ate_rmse_m"):
    """How many times smaller slam's error is than dead reckoning's."""
    return measured(dataset, "dead-reckoning")[key] / measured(dataset)[key]


def test_every_scene_is_named_in_a_test():
    tests = "".join(path.read_text() for path in Path(__file__).parent.rglob("*.py"))
    scenes = [path.stem for path in SCENES.glob("*.yaml")]
    assert len(scenes) >= 8
    assert [name for name in scenes if f'"{name}"' not in tests] == []


@pytest.mark.parametrize("name", OF_CONSISTENCY)
def test_scenes_for_consistency_keep_the_depth_rule(name):
    scene = load(SCENES / f"{name}.yaml")
    sigma_px = np.max(scene.camera.sigma_px)
    rule_m = 0.05 * scene.rig.fx_px * scene.rig.baseline_m / (np.sqrt(2) * sigma_px)
    assert scene.rig.depth_m[1] <= rule_m


@pytest.mark.parametrize(
    ("name", "times"), [("figure8", 5), ("circle", 5), ("corridor", 5), ("helix", 5), ("hover", 2)]
)
def test_slam_cuts_the_error_where_a_scene_is_benign(name, times):
    dataset = data(name)
    values = measured(dataset)
    assert measured(dataset, "dead-reckoning")["ate_rmse_m"] > times * values["ate_rmse_m"]
    assert 0.95 < values["nis_mean_per_dof"] < 1.05
    assert values["rejected"] == values["skipped_features"] == 0


def test_circle_meets_its_beginning_again_and_slam_knows_it():
    dataset = data("circle")
    position = dataset.truth.T_world_imu[:, :3, 3]
    lap = round(len(dataset) / 1.2)
    assert np.linalg.norm(position[lap] - position[0]) < 0.5
    first = set(dataset.frame(0).ids.tolist())
    assert len(first & set(dataset.frame(lap).ids.tolist())) >= 3


def test_hover_stays_and_dead_reckoning_wanders():
    dataset = data("hover")
    true = dataset.truth.T_world_imu[:, :3, 3]
    assert np.abs(true - true[0]).max() < 0.7
    assert np.ptp(np.diff(dataset.times_s)) > 0.02
    assert len(np.unique(dataset.sightings.ids)) >= 25


def test_helix_climbs_8_m_and_never_comes_back():
    height = data("helix").truth.T_world_imu[:, 2, 3]
    assert height[-1] - height[0] == pytest.approx(8, abs=0.1)
    assert (np.diff(height) > 0).all()


def test_corridor_hides_what_is_behind_its_corners_and_meets_nothing_again():
    dataset = data("corridor")
    without_walls = simulate(load(SCENES / "corridor.yaml", ["camera.walls=[]"]))
    assert len(without_walls.sightings) > 1.4 * len(dataset.sightings)
    first, last = (
        np.concatenate([dataset.frame(i).ids for i in some])
        for some in (range(100), range(300, 401))
    )
    assert len(np.intersect1d(first, last)) == 0


def test_the_gate_of_outliers_is_what_saves_the_estimate():
    dataset = data("outliers")
    assert dataset.gate == 0.999
    gated, open_ = measured(dataset), measured(replace(dataset, gate=None))
    assert open_["ate_rmse_m"] > 3 * gated["ate_rmse_m"]
    assert open_["nis_mean_per_dof"] > 5 > 1.2 > gated["nis_mean_per_dof"]
    assert 0.05 < gated["rejected"] / (gated["accepted"] + gated["rejected"]) < 0.25
    assert gated["skipped_features"] > 20
    assert cut(dataset) > 5


def test_two_laps_meets_its_first_lap_again_after_250_m():
    dataset = data("two_laps")
    lap = len(dataset) // 2
    path = np.linalg.norm(np.diff(dataset.truth.T_world_imu[:, :3, 3], axis=0), axis=1).sum()
    assert path == pytest.approx(4 * np.pi * 40, rel=1e-3)
    assert len(np.intersect1d(dataset.frame(0).ids, dataset.frame(lap).ids)) >= 3


def test_zhang_has_the_size_that_the_paper_tells():
    dataset = data("zhang")
    position = dataset.truth.T_world_imu[:, :3, 3]
    assert np.ptp(position, axis=0) == pytest.approx([50, 40, 20], rel=0.05)
    assert (len(dataset), len(dataset.truth.landmarks)) == (501, 300)
    assert not dataset.prior.pose_covariance.any()
    assert np.linalg.norm(dataset.sightings.points, axis=1).max() < 20 * 1.05
    assert len(dataset.sightings) / len(dataset) > 10


def test_figure8_noisy_loses_dead_reckoning_and_the_camera_brings_it_back():
    datasets = [data("figure8_noisy", seed) for seed in range(3)]
    lost = [measured(d, "dead-reckoning") for d in datasets]
    found = [measured(d) for d in datasets]
    error = np.median([v["ate_rmse_m"] for v in lost]), np.median([v["ate_rmse_m"] for v in found])
    assert error[0] > 1.5
    assert error[0] > 5 * error[1]
    assert np.median([v["pose_nees_mean"] for v in found]) > 1.5 * 6


def test_drive_has_the_size_and_the_statistics_of_the_real_one():
    dataset = data("drive")
    sightings, rig = dataset.sightings, dataset.calibration.rig
    assert (rig.fx_px, rig.cx_px, rig.cy_px, rig.baseline_m) == (552.554, 682.049, 238.770, 0.6)
    assert (len(dataset), dataset.gate) == (1010, 0.999)
    assert dataset.times_s[-1] - dataset.times_s[0] == pytest.approx(105.5, abs=0.5)
    assert 4700 < len(np.unique(sightings.ids)) <= 5105
    assert 60 < len(sightings) / len(dataset) < 72
    _, track = np.unique(sightings.ids, return_counts=True)
    assert 8 <= np.median(track) <= 13
    assert track.min() >= 3
    valid = validity(rig, sightings.pixels) == Validity.VALID
    depth = triangulate(rig, sightings.pixels[valid])[:, 2]
    assert 20 < np.percentile(depth, 5) < 35
    assert 45 < np.median(depth) < 75
    assert 130 < np.percentile(depth, 95) < 250
    turned = so3.log(dataset.truth.T_world_imu[0, :3, :3].T @ dataset.truth.T_world_imu[-1, :3, :3])
    assert np.linalg.norm(turned) > 0.5
    values = measured(dataset)
    assert values["path_length_m"] == pytest.approx(1342, rel=0.01)
    assert values["landmarks"] > 4700
    assert values["final_position_error_m"] < 0.05 * values["path_length_m"]
    assert measured(dataset, "dead-reckoning")["ate_rmse_m"] > 2 * values["ate_rmse_m"]


@pytest.fixture(scope="module")
def drive_large():
    return data("drive_large")


def test_drive_large_has_the_size_of_the_longest_real_one(drive_large):
    sightings, rig = drive_large.sightings, drive_large.calibration.rig
    assert (rig.fx_px, rig.cx_px, rig.cy_px, rig.baseline_m) == (552.554, 682.049, 238.770, 0.6)
    assert (len(drive_large), drive_large.gate) == (3026, 0.999)
    assert np.diff(drive_large.times_s).mean() == pytest.approx(0.1046, abs=1e-3)
    assert len(np.unique(sightings.ids)) == pytest.approx(13289, rel=0.005)
    assert path_length(drive_large.truth.T_world_imu) == pytest.approx(2957, rel=0.005)
    assert 60 < len(sightings) / len(drive_large) < 73
    frames, track = np.diff(sightings.start), np.unique(sightings.ids, return_counts=True)[1]
    assert frames.min() > 0
    assert 8 <= np.median(track) <= 13
    assert track.min() >= 3


@pytest.mark.slow
def test_the_whole_map_of_drive_large_is_estimated(drive_large):
    values = measured(drive_large)
    assert values["landmarks"] > 13_000
    assert values["final_position_error_m"] < 0.1 * values["path_length_m"]
    assert measured(drive_large, "dead-reckoning")["ate_rmse_m"] > values["ate_rmse_m"]
