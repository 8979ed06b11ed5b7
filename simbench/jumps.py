"""Sightings that jump: a stereo match that slips to another place, for a frame or for good.

Of real tracks two in a hundred steps do, by five pixels and more. A filter's gate sees each
sighting alone, and lets a jump pass that a wide motion noise could explain; all features of two
frames together know the motion far better, and what it leaves of a jump stands out. A track that
jumped for good shows one point in the left image from there on and another in the right one: the
depth of the one and the way of the other are no point's.
"""

from dataclasses import replace

import numpy as np
from scipy.special import chdtri

from simbench.dataset import Dataset, Sightings
from simbench.noise import MEDIAN, ROWS, Pairs
from vislam.arrays import BoolArray, IntArray
from vislam.filters import model

#: A jump is what chance does less often than once in ten thousand steps.
GATE = float(chdtri(ROWS, 1e-4))
ROUNDS = 5
#: Added to the variances of motions, which may be told to be exact.
EXACT = 1e-12


def without_jumps(dataset: Dataset) -> Dataset:
    """The same drive without sightings that jump, and without what follows one that stays there.

    The dataset itself comes back where nothing jumps, and where the truth is known: there the noise
    told is right, outliers and gate included.
    """
    sightings = dataset.sightings
    if dataset.truth is not None or not isinstance(sightings, Sightings):
        return dataset
    once, for_good = jumps(dataset)
    if not (once | for_good).any():
        return dataset
    note = (
        f"{np.count_nonzero(once)} sightings jump for one frame and {np.count_nonzero(for_good)} "
        "tracks for good: they, and what follows the latter, are left out."
    )
    kept = sightings.only(~once & ~sightings.since(for_good))
    return replace(dataset, sightings=kept, notes=(*dataset.notes, note))


def jumps(dataset: Dataset) -> tuple[BoolArray, BoolArray]:
    """Which sightings jump from the one before and back, and which jump and stay, shapes (S,)."""
    assert dataset.sightings is not None
    count = len(dataset.sightings)
    away, same = np.zeros(count, bool), np.zeros(count, bool)
    after = np.full(count, -1)  # the sighting of the same track in the next frame
    first, second, off = _steps(dataset, 1)
    away[second[off]] = True
    after[first] = second
    first, _, off = _steps(dataset, 2)
    between = after[first[~off]]
    same[between[between >= 0]] = True
    once = away & same
    returns = after[once & (after >= 0)]  # from a jump: itself it does not
    away[returns] = False
    return once, away & ~once


def _steps(dataset: Dataset, lag: int) -> tuple[IntArray, IntArray, BoolArray]:
    """Sightings and those `lag` frames later, by place, and whether one jumps between, (n,)."""
    pairs = Pairs.of(dataset, lag)
    if not len(pairs.residual):
        return pairs.first, pairs.second, np.zeros(0, bool)
    dt = np.diff(dataset.times_s)
    Q = np.stack(
        [
            model.process_noise(dataset.noise, dataset.twist(i), dt[i : i + lag].sum()) / lag
            for i in pairs.frame.tolist()
        ]
    )
    information = np.asarray(np.linalg.inv(Q + EXACT * np.eye(6)))
    told_px2 = float(np.mean(np.square(dataset.noise.sigma_px)))
    x = np.zeros((len(pairs.frame), 6))
    for _ in range(ROUNDS):
        left = pairs.left_by(x)
        px2 = max(float(np.median(left)) / MEDIAN, told_px2)
        fits = left <= GATE * px2
        x, _ = pairs.motion_errors(np.where(fits, 1 / px2, 0.0), information)
    return pairs.first, pairs.second, pairs.left_by(x) > GATE * px2
