"""The formulas of which EKF-SLAM is made, each replaceable."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TypeAlias

from vislam.arrays import Array, BoolArray
from vislam.charts import RIGHT, Chart
from vislam.filters import model
from vislam.filters.estimate import Estimate
from vislam.filters.observation import Observation
from vislam.filters.records import Correct, Linear, Record
from vislam.types import Calibration, Noise, Twist


def at_estimate(x: Estimate) -> tuple[Array, Array]:
    """Linearise at the present estimate, as the extended Kalman filter does."""
    return x.T, x.landmarks


def as_recorded(record: Record, P: Array) -> Array:
    """The covariance after a record, as the record says, in the place of the one before."""
    return record.onto(P)


def added(chart: Chart, x: Estimate, delta: Array) -> tuple[Array, Array]:
    """The pose and landmarks that an error vector leads to, as the chart has it."""
    return chart.retract(x.T, x.landmarks, delta)


#: (first correction, observation by error vector, correction by observation) -> last correction.
Iteration: TypeAlias = Callable[
    [Correct, Callable[[Array], Observation], Callable[[Observation], Correct]], Correct
]


@dataclass(frozen=True, slots=True)
class Parts:
    """The formulas of the recursion. A variant of the filter replaces some, and nothing else.

    The defaults are the paper's; `vislam.filters.model` says what each takes and returns.

    Attributes:
        chart: error and retraction.
        retract: the pose and landmarks that an error vector leads to.
        from_right: columns that turn the pose's error of the paper's chart into the state's error
            of this one at (pose, landmarks), shape (..., 6 + 3m, 6); None where they are one.
        linearise: the pose and landmarks at which Jacobians are taken.
        transition: F, from the linearisation pose and the predicted one.
        process_noise: what a step adds to the pose's covariance.
        valid: which features can be used.
        observation_jacobians: of the readings by pose and landmark.
        whitening: of residuals, by the readings as predicted.
        gate: which sightings to accept; asked of bounds first (`vislam.filters.gating`).
        split: the parts in which an observation is taken in.
        correct: the update that a part of an observation makes of a state of this covariance.
        birth: new landmarks, their Jacobian by the pose's error, their own covariance.
        iterate: the last correction, from the first, from the sightings linearised where an error
            vector leads, and from the update that they make; None where the first is the last.
        transport: what an update that moved an estimate to (pose, landmarks) does to the covariance
            besides; None for nothing.
        change: the covariance after a record; the one before is given up.
    """

    chart: Chart = RIGHT
    retract: Callable[[Chart, Estimate, Array], tuple[Array, Array]] = added
    from_right: Callable[[Array, Array], Array] | None = None
    linearise: Callable[[Estimate], tuple[Array, Array]] = at_estimate
    transition: Callable[[Array, Array], Array] = model.transition
    process_noise: Callable[[Noise, Twist, float], Array] = model.process_noise
    valid: Callable[[Calibration, Array], BoolArray] = model.valid
    observation_jacobians: Callable[[Calibration, Array, Array], tuple[Array, Array]] = (
        model.observation_jacobians
    )
    whitening: Callable[[Noise, Array], Array] = model.whitening
    gate: Callable[[Array, float, int], BoolArray] = model.gate
    split: Callable[[Observation], Iterable[Observation]] = Observation.parts
    correct: Callable[[Observation, Array], Correct] = Correct.of
    birth: Callable[[Calibration, Noise, Array, Array, Array], tuple[Array, Array, Array]] = (
        model.inverse_observation
    )
    iterate: Iteration | None = None
    transport: Callable[[Estimate, Array, Array], Linear] | None = None
    change: Callable[[Record, Array], Array] = as_recorded


PAPER = Parts()
