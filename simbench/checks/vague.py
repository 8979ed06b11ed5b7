"""Covariances where rounding is put to the test.

In the other scenes an update takes away a part of a variance, and rounding hurts nobody. Here the
first one takes away nearly all: a filter in a known map hardly knows where it starts.
"""

from dataclasses import replace

import numpy as np

from simbench.checks.result import CheckResult, NotApplicable, check, judged
from simbench.checks.scenes import drive as scene
from simbench.checks.short_drive import ShortDrive
from simbench.checks.trace import SCENE, Feed, covariances, trace
from vislam.filters import Factory
from vislam.gaussian import covariance_fault

#: Of the start's place and the map's, m, and of a pixel: the first update leaves a ten-billionth of
#: a variance, and still predicts every pixel better than by the width of an image.
START_SIGMA_M, MAP_SIGMA_M, PIXEL_SIGMA = 3.0, 1e-4, 0.03


@check
def find_the_place(factory: Factory, drive: ShortDrive | None = None) -> CheckResult:
    """A start known to 3 m in a map known to 0.1 mm: covariances stay covariances.

    No noise is realised: linear or not, the estimate stays where it is.
    """
    drive = scene(SCENE) if drive is None else drive
    feed, truth = Feed.of(drive, noise=0.0), drive.state(0)
    P = drive.dataset.prior.pose_covariance
    if P is None:
        raise NotApplicable("the scene states no covariance of the start")
    vague = P.copy()
    vague[:3, :3] = START_SIGMA_M**2 * np.eye(3)
    vague[:3, 3:], vague[3:, :3] = 0, 0
    prior = replace(
        feed.task.prior,
        pose_covariance=vague,
        ids=truth.ids,
        landmarks=truth.landmarks,
        landmark_covariances=np.tile(MAP_SIGMA_M**2 * np.eye(3), (len(truth.ids), 1, 1)),
    )
    noise = replace(feed.task.noise, sigma_px=np.full(4, PIXEL_SIGMA))
    task = replace(feed.task, prior=prior, noise=noise)
    calls = trace(factory, replace(feed, task=task))
    if not any(covariances(call.belief) for call in calls):
        raise NotApplicable("the filter states no covariance")
    faults = [
        f"{call.name}: the {name} covariance is {fault}"
        for call in calls
        for name, P in covariances(call.belief)
        if (fault := covariance_fault(P)) is not None
    ]
    return judged(
        len(faults),
        0,
        good="symmetric and positive semidefinite, though an update takes nearly all away",
        bad=f"{faults[0] if faults else ''}; {len(faults)} such in all",
    )
