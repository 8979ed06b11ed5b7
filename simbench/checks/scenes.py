"""The small scenes that an audit runs on, chosen so that no mistake vanishes by accident.

All have jittered times, a camera away from the IMU, a heading and a place far from identity, other
noise on each axis, births in mid-run, gaps in the sightings, and most a gate. They differ in the
noise model, in how much is seen, and in what is halved.
"""

from functools import cache

from simbench.checks.short_drive import ShortDrive
from simbench.scenario import loads
from simbench.sensors import simulate

_COMMON = """
rate_hz: 4.0
time_jitter: 0.6
trajectory:
  kind: straight
  speed_mps: 1.5
  roll_deg: 10.0
  pitch_deg: 8.0
  roll_period_s: 2.0
  pitch_period_s: 1.5
  start: {translation_m: [120.0, -80.0, 15.0], rotvec_deg: [20.0, -30.0, 140.0]}
rig:
  cx_px: 620.0
  cy_px: 600.0
  image_px: [1242, 1200]
  depth_m: [1.0, 14.0]
  imu_cam: {translation_m: [1.1, -0.3, 0.7], rotvec_deg: [4.0, -6.0, 3.0]}
imu:
  velocity: {sigma: [0.1, 0.2, 0.3]}
  angular_velocity: {sigma: [0.02, 0.03, 0.05]}
prior: {sigma_translation_m: 0.1, sigma_rotation_deg: 1.0}
"""

#: What each scene is for, and what it has beside the common part.
SCENES = {
    "births": (
        "births in mid-run, sightings lost and halved, four pixel sigmas",
        """
        seed: 5
        duration_s: 1.5
        landmarks: {kind: path, count: 6, lateral_m: [0.3, 2.0], height_m: [-0.5, 0.8], ahead_m: 12}
        camera: {sigma_px: [0.7, 1.3, 0.9, 0.5], dropout: 0.25, half_missing: 0.15}
        filter: {process_noise: twist, gate: 0.999}
        """,
    ),
    "additive": (
        "the paper's constant W",
        """
        seed: 6
        duration_s: 1.5
        landmarks: {kind: path, count: 5, lateral_m: [0.3, 2.0], height_m: [-0.5, 0.8], ahead_m: 12}
        camera: {sigma_px: 1.4, dropout: 0.2, half_missing: 0.1}
        filter: {process_noise: additive, gate: 0.999}
        """,
    ),
    "density": (
        "process noise as a density, so that it depends on the interval",
        """
        seed: 7
        duration_s: 1.5
        landmarks: {kind: path, count: 5, lateral_m: [0.3, 2.0], height_m: [-0.5, 0.8], ahead_m: 12}
        camera: {sigma_px: 0.6, dropout: 0.2}
        filter: {process_noise: twist-density, gate: 0.999}
        """,
    ),
    "gaps": (
        "few landmarks, often out of sight and met again",
        """
        seed: 8
        duration_s: 2.25
        landmarks: {kind: path, count: 3, lateral_m: [0.3, 2.0], height_m: [-0.5, 0.8], ahead_m: 14}
        camera: {sigma_px: 0.8, dropout: 0.5}
        filter: {process_noise: twist, gate: none}
        """,
    ),
}
#: Scalars of noise in a scene, at the most.
MOST_SCALARS = 256


@cache
def drive(name: str) -> ShortDrive:
    """The short drive of an audit scene."""
    _, own = SCENES[name]
    lines = (line[8:] for line in own.splitlines())
    scenario = loads("\n".join([f"name: {name}", *lines]) + _COMMON, where=f"scene {name}")
    return ShortDrive.of(simulate(scenario), MOST_SCALARS)
