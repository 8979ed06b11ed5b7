"""What filters are told of a file that says nothing of noise, and how that is said to the user."""

from dataclasses import replace

import numpy as np

from simbench.dataset import Dataset
from simbench.noise import Estimate, by_this_and_next_sample, estimate
from vislam.arrays import Array
from vislam.types import Noise

#: The gate that a filter is told where the file says nothing: real tracks jump.
GATE = 0.999
#: The next velocity sample is said to fit better where it predicts by so much nearer.
CLEARLY_NEARER = 0.9


def with_estimated_noise(dataset: Dataset) -> Dataset:
    """The dataset told the noise that its own data show, with notes that say so."""
    found = estimate(dataset)
    process = np.diag(np.square(np.concatenate([found.velocity, found.angular])))
    noise = Noise(process_model="twist", process=process, sigma_px=np.full(4, found.sigma_px))
    notes = (*dataset.notes, _noise_note(found), *_timing_notes(dataset))
    return replace(dataset, noise=noise, notes=notes)


def _noise_note(found: Estimate) -> str:
    if found.epipolar_px is None:
        pixels = f"{found.sigma_px:.2g} px, a guess without features"
    elif found.sigma_px > 1.01 * found.epipolar_px:
        pixels = f"{found.sigma_px:.2g} px (vL - vR alone {found.epipolar_px:.2g} px: tracks slide)"
    else:
        pixels = f"{found.sigma_px:.2g} px"
    return (
        f"The file says nothing of noise. As estimated from its data, filters are told {pixels}, "
        f"{_each(found.velocity)} m/s and {_each(found.angular)} rad/s in x, y and z, a start at "
        f"identity with no uncertainty, and a gate of {GATE:g}; --noise-pixel-px, "
        "--noise-velocity, --noise-angular and --gate change it."
    )


def _each(sigmas: Array) -> str:
    return ", ".join(f"{sigma:.2g}" for sigma in sigmas)


def _timing_notes(dataset: Dataset) -> list[str]:
    """On real drives the next sample predicts better, and yet no filter ends nearer with it."""
    medians = by_this_and_next_sample(dataset)
    if medians is None or medians[1] > CLEARLY_NEARER * medians[0]:
        return []
    return [
        "The velocities come a little late: sample i + 1 predicts the features from frame i to "
        f"i + 1 to {medians[1]:.2f} px, sample i to {medians[0]:.2f} px. The latter is used, as "
        "the format has it; what it is off by is in the noise told."
    ]
