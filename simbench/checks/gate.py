"""Does a gate refuse as many right sightings as it says?"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from simbench.checks.result import CheckResult, NotApplicable, check, judged
from simbench.checks.scenes import drive as scene
from simbench.checks.short_drive import ShortDrive
from simbench.checks.trace import SCENE, driven
from simbench.rng import stream
from vislam.arrays import Array, BoolArray
from vislam.filters import Factory

#: The gate is told to let this share of right sightings pass: so few that the rest can be counted.
PROBABILITY = 0.9
RUNS = 600
#: That a right gate leaves the band, over the choice of the stream; the stream is fixed.
FALSE_ALARM = 1e-4


@check
def refuse_as_often_as_told(factory: Factory, drive: ShortDrive | None = None) -> CheckResult:
    """Of right sightings at real noise, a gate of probability p refuses the share 1 - p.

    One sighting of each run counts, of the first frame in which any is tested: those of one run
    depend on one another, and later ones on what was refused before.
    """
    from scipy.stats import binom

    drive = scene(SCENE) if drive is None else drive
    accepted = np.array(list(_answers(factory, drive)))
    refused = int(np.count_nonzero(~accepted))
    low, high = (
        float(binom.ppf(p, RUNS, 1 - PROBABILITY)) for p in (FALSE_ALARM / 2, 1 - FALSE_ALARM / 2)
    )
    middle = RUNS * (1 - PROBABILITY)
    text = (
        f"{refused} of {RUNS} right sightings refused by a gate of {PROBABILITY}, "
        f"expected {low:.0f} to {high:.0f} (false alarm {FALSE_ALARM:g})"
    )
    cause = (
        ": no gate, or too wide a one" if refused < low else ": as with too few degrees of freedom"
    )
    return judged(
        0.0 if low <= refused <= high else abs(refused - middle),
        0.0,
        good=text,
        bad=text + cause,
    )


def _answers(factory: Factory, drive: ShortDrive) -> Iterator[bool]:
    """What the gate says of one sighting in each run."""
    w = stream(0, 0, "checks.gate").standard_normal((RUNS, drive.scalars))
    if driven(factory, drive.task).batched:
        accepted = _first_answers(factory, drive, w)
        yield from accepted[np.arange(RUNS), np.arange(RUNS) % accepted.shape[1]].tolist()
    else:
        for i, one in enumerate(w):
            accepted = _first_answers(factory, drive, one)
            yield bool(accepted[i % len(accepted)])


def _first_answers(factory: Factory, drive: ShortDrive, w: Array) -> BoolArray:
    """What the gate says of the first frame that it tests, shape (..., k)."""
    readings = drive.realise(w)
    filter_ = driven(factory, replace(drive.task, prior=readings.prior, gate=PROBABILITY))
    for done in filter_.feed(drive.inputs(readings)):
        if done.innovation is not None and len(done.innovation.ids):
            belief = filter_.belief(done.name)
            if belief.pose_covariance is None and not np.allclose(
                belief.T_world_imu, drive.T_world_imu[done.frame], atol=1e-6
            ):
                raise NotApplicable("the filter takes a pose for the truth that is not")
            return np.broadcast_to(
                done.innovation.accepted, (*w.shape[:-1], len(done.innovation.ids))
            )
    raise NotApplicable("the filter states no innovation")
