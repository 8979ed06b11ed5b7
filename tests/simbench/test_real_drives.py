"""`run` with no options on drives as the course gives them out: sane, and near."""

from pathlib import Path

import numpy as np
import pytest

from simbench.filters import resolve
from simbench.metrics import ate, metrics, path_length, rmse
from simbench.metrics.fit import noise_fit
from simbench.npz import read_npz
from simbench.run import prepared, run
from tests.simbench.drives import (
    drive,
    with_jumps,
    with_repeats,
    with_standing_pictures,
    write_bare,
)

REAL = Path(__file__).parents[3] / "shared/data"


def ran(path, name="slam"):
    """As the verb does it with no options."""
    dataset, options = prepared(read_npz(path))
    return run(dataset, resolve(name), name=name, options=options)


def error_m(record, truth):
    return rmse(ate(record.T_world_imu, truth.T_world_imu).translation_m)


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("dialect", ["2019", "2022-as-distributed"])
def test_a_noisy_drive_ends_far_nearer_than_dead_reckoning(tmp_path, dialect, seed):
    data = with_jumps(drive(0.5, 0.05, seed=seed))
    path = write_bare(tmp_path / "drive.npz", data, dialect)
    record = ran(path)
    reckoned = error_m(ran(path, "dead-reckoning"), data.truth)
    assert error_m(record, data.truth) < 0.4 * reckoned
    assert path_length(record.T_world_imu) == pytest.approx(
        path_length(data.truth.T_world_imu), rel=0.05
    )
    assert 0.3 < metrics(record)["nis_mean_per_dof"] < 2.0


def test_tracks_that_jump_and_repeat_still_help(tmp_path):
    data = with_repeats(with_jumps(drive(0.5, 0.05, seed=1)))
    path = write_bare(tmp_path / "drive.npz", data, "2022")
    reckoned = error_m(ran(path, "dead-reckoning"), data.truth)
    assert error_m(ran(path), data.truth) < 0.8 * reckoned


@pytest.mark.parametrize("faulty", [with_repeats, with_standing_pictures])
@pytest.mark.parametrize("seed", [1, 2])
def test_frames_that_repeat_cost_little_of_what_the_others_say(tmp_path, faulty, seed):
    """Rates so wild that a frame without a word from the features costs more than all others."""
    data = faulty(drive(0.1, 0.05, seconds=12.0, seed=seed))
    path = write_bare(tmp_path / "drive.npz", data, "2022")
    reckoned = error_m(ran(path, "dead-reckoning"), data.truth)
    assert error_m(ran(path), data.truth) < 0.4 * reckoned


def test_jumps_that_a_wide_motion_noise_would_let_pass_leave_no_trace(tmp_path):
    """The gate alone takes 5 % and more of them in, and NIS/dof is 1.4."""
    data = with_jumps(drive(0.5, 0.05, 0.3, seconds=12.0, seed=1))
    values = metrics(ran(write_bare(tmp_path / "drive.npz", data, "2022")))
    assert 0.85 < values["nis_mean_per_dof"] < 1.15
    assert values["rejected_share"] < 0.02
    assert values["noise_fit"] == "The noise told fits the data."


def test_where_dead_reckoning_is_nearly_perfect_features_do_no_harm(tmp_path):
    data = with_jumps(drive(0.0, 0.0, seed=1))
    record = ran(write_bare(tmp_path / "drive.npz", data, "2022"))
    assert error_m(record, data.truth) < 0.003 * path_length(data.truth.T_world_imu)


def test_a_drive_without_features_is_dead_reckoned(tmp_path):
    data = drive(0.1, 0.01, seconds=10.0)
    path = write_bare(tmp_path / "drive.npz", data, "2021")
    ends = [ran(path, name).T_world_imu[-1] for name in ("slam", "dead-reckoning")]
    np.testing.assert_allclose(ends[0], ends[1], rtol=0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "highest_m", "rejected"), [("2022/03.npz", 80, 0.02), ("2019/0020.npz", 60, 0.06)]
)
def test_a_real_drive_is_sane(name, highest_m, rejected):
    """Nobody knows how high the road of 2022 goes; dead reckoning says 249 m."""
    if not (REAL / name).is_file():
        pytest.skip("the real drive is not here")
    record = ran(REAL / name)
    dataset, values = record.dataset, metrics(record)
    speed = np.linalg.norm(dataset.linear_velocity, axis=1)
    measured_m = np.sum(speed[:-1] * np.diff(dataset.times_s))
    assert values["path_length_m"] == pytest.approx(measured_m, rel=0.02)
    assert np.abs(record.T_world_imu[:, 2, 3]).max() < highest_m
    assert 0.3 < values["nis_mean_per_dof"] < 2.0
    assert values["rejected_share"] < rejected


@pytest.mark.parametrize(
    ("nis", "share", "gate", "said"),
    [
        (1.0, 0.001, 0.999, "The noise told fits the data."),
        (1.0, 0.0, None, "The noise told fits the data."),
        (9.0, 0.001, 0.999, "3.0 times as large as the noise told explains"),
        (0.25, 0.001, 0.999, "0.5 times the size"),
        (
            1.0,
            0.1,
            0.999,
            "10 % of the sightings were rejected, with noise as told it would be 0.1 %",
        ),
    ],
)
def test_a_misfit_is_said_in_words(nis, share, gate, said):
    assert said in noise_fit(nis, share, gate)


def test_where_nothing_was_tested_nothing_is_said():
    assert noise_fit(None, None, 0.999) is None
