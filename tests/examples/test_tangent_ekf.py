"""The example of a filter of one's own is judged, and a mistake planted in it is located."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from simbench.checks.audit import audit_drive
from simbench.checks.short_drive import ShortDrive
from simbench.run import run
from simbench.scenario import loads
from simbench.sensors import simulate
from vislam.filters import EkfSlam

SOURCE = Path(__file__).with_name("tangent_ekf.py").read_text(encoding="utf-8")
#: Four frames with a birth in the third, a heading and a place.
SCENE = """
name: four
seed: 3
duration_s: 0.75
rate_hz: 4.0
time_jitter: 0.6
trajectory:
  kind: straight
  roll_deg: 10.0
  start: {translation_m: [120.0, -80.0, 15.0], rotvec_deg: [0.0, 0.0, 90.0]}
landmarks: {kind: file, text: "118.0 -72.0 15.0\\n120.5 -66.5 15.5"}
camera: {sigma_px: [0.7, 1.3, 0.9, 0.5]}
"""


def tangent_ekf(line="", planted=""):
    assert line in SOURCE
    module = {}
    exec(SOURCE.replace(line, planted) if line else SOURCE, module)
    return module["TangentEkf"]


@pytest.fixture(scope="module")
def drive():
    drive = ShortDrive.of(simulate(loads(SCENE)), 2000)
    assert [len(frame.ids) for frame in drive.schedule] == [1, 1, 2, 2]
    return drive


def test_example_passes_the_audit(drive):
    assert audit_drive(tangent_ekf(), drive).passed


@pytest.mark.parametrize(
    ("line", "planted", "call", "block"),
    [
        ("se3.inverse(T_next) @ self.T", "se3.inverse(self.T) @ T_next", "predict 0", "pose-land"),
        ("self.noise.sigma_px**2", "self.noise.sigma_px", "update 1", "landmark cov"),
        ("np.pad(G.reshape(-1, 6)", "0 * np.pad(G.reshape(-1, 6)", "update 0", "landmark cov"),
        ("self.T @ se3.exp(self.ekf.x[:6])", "se3.exp(self.ekf.x[:6]) @ self.T", "update 1", ""),
    ],
)
def test_planted_mistake_is_located(drive, line, planted, call, block):
    two_frames = replace(drive, frames=2)  # each of these shows at once
    first = audit_drive(tangent_ekf(line, planted), two_frames).first
    assert first.call == call
    assert first.block.startswith(block)


def test_example_is_the_same_filter_as_ours(drive):
    ours, theirs = (run(drive.dataset, factory) for factory in (EkfSlam, tangent_ekf()))
    np.testing.assert_allclose(theirs.T_world_imu, ours.T_world_imu, rtol=0, atol=1e-10)
    np.testing.assert_allclose(theirs.pose_covariances, ours.pose_covariances, rtol=0, atol=1e-12)
