"""A known map stays where it is, however far its sightings move the pose.

A filter whose error ties the landmarks to the pose, as an invariant one does, moves both in an
update and must come out where a known landmark has not moved at all. A retraction that is right to
first order alone moves it by a half of its distance times the square of the turn, and shows
nowhere else before a loop closes.
"""

from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from simbench.checks.result import CheckResult, NotApplicable, check, judged
from simbench.checks.scenes import drive as scene
from simbench.checks.short_drive import ShortDrive
from simbench.checks.trace import SCENE, Feed, trace
from vislam.filters import Factory
from vislam.lie import se3
from vislam.types import Belief

#: How well the map is known, m.
MAP_SIGMA_M = 1e-6
#: By so much a landmark may move, m: a filter that takes wrong poses for true, and says so, moves
#: one by a fifth of its sigma in a few sightings.
LIMIT_M = 1e-4
#: By so much the start is off, m and rad, and as unsure as that; and a pixel's sigma. What an
#: update leaves of the turn is some pixels, which cannot move what is so well known.
START_ERROR = np.array([0.1, -0.1, 0.1, 0.05, -0.05, 0.05])
PIXEL_SIGMA = 1.0


@check
def keep_the_known_map(factory: Factory, drive: ShortDrive | None = None) -> CheckResult:
    """A start that is 5 degrees off, in a map known to a micrometre: the map does not move.

    No noise is realised. Judged are the landmarks that the filter holds from the start.
    """
    drive = scene(SCENE) if drive is None else drive
    feed, truth = Feed.of(drive, noise=0.0), drive.state(0)
    each = np.tile(MAP_SIGMA_M**2 * np.eye(3), (len(truth.ids), 1, 1))
    P_pose = np.diag(START_ERROR**2)
    prior = Belief(
        T_world_imu=truth.T_world_imu @ se3.exp(START_ERROR),
        pose_covariance=P_pose,
        ids=truth.ids,
        landmarks=truth.landmarks,
        landmark_covariances=each,
        joint_covariance=block_diag(P_pose, *each),
    )
    noise = feed.task.noise
    if len(noise.sigma_px):
        noise = replace(noise, sigma_px=np.full(4, PIXEL_SIGMA))
    task = replace(feed.task, prior=prior, noise=noise, gate=None)
    start, *calls = trace(factory, replace(feed, task=task))
    held = np.intersect1d(start.belief.ids, truth.ids)
    if not len(held):
        raise NotApplicable("the filter holds no known map")
    worst_m, where = 0.0, "start"
    for call in calls:
        known = np.isin(call.belief.ids, held)
        places = np.searchsorted(truth.ids, call.belief.ids[known])
        apart_m = np.linalg.norm(call.belief.landmarks[known] - truth.landmarks[places], axis=-1)
        moved_m = float(np.nan_to_num(apart_m, nan=np.inf).max(initial=0.0))
        if moved_m > worst_m:
            worst_m, where = moved_m, call.name
    return judged(
        worst_m,
        LIMIT_M,
        good="landmarks known to a micrometre stay where they are",
        bad=f"{where} moves a landmark by {worst_m:.2g} m that is known to a micrometre",
    )
