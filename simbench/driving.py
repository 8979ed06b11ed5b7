"""Calls into the filter under test: named, timed, and what comes back looked at before its use.

All that drives a filter does it here, so a filter that is none is the same to a run, to an audit
and to every check: a `FilterFailure` at the call that went wrong.
"""

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, ParamSpec, TypeAlias, TypeVar

import numpy as np

from simbench.errors import FilterFailure
from vislam.arrays import Array
from vislam.charts import CHARTS
from vislam.filters.protocol import Factory, Filter, Finishing
from vislam.types import Belief, Frame, ImuSample, Innovation, Smoothed, State, Task, Twist

P = ParamSpec("P")
R = TypeVar("R")

#: What goes into a filter: a frame, or a motion with the seconds that it lasts.
Input: TypeAlias = Frame | tuple[Twist | ImuSample, float]
Shape: TypeAlias = tuple[int, ...]


class Watch:
    """Calls into the filter under test: adds up their time, and names the call that raises."""

    def __init__(self) -> None:
        self.total_s = 0.0

    def __call__(self, call: str, function: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> R:
        """Call the function, under the name `call`.

        Raises:
            FilterFailure: it raised.
        """
        start = time.perf_counter()
        try:
            return function(*args, **kwargs)
        except Exception as error:  # a stranger's filter may raise anything
            raise FilterFailure(call, f"raised {type(error).__name__}: {error}") from error
        finally:
            self.total_s += time.perf_counter() - start


@dataclass(frozen=True, slots=True, kw_only=True)
class Done:
    """A call that the filter has come through.

    Attributes:
        name: such as "predict 2", numbered by the frame that it starts from or takes in.
        frame: the index of the frame that it takes in or leads to.
        taken: whether it took the frame in.
        innovation: of an update that has one.
    """

    name: str
    frame: int
    taken: bool
    innovation: Innovation | None = None


class Driven:
    """A filter under test.

    Attributes:
        filter: as its factory made it.
        watch: the time spent in it.
        raw: whether it asks for raw IMU samples in place of twists.
        batched: whether it takes many runs along a batch axis.
    """

    def __init__(self, factory: Factory, task: Task) -> None:
        """Start a filter.

        Raises:
            FilterFailure: it raised, or lacks a method that a filter has.
        """
        self.watch = Watch()
        self.filter: Filter = self.watch("start", factory, task)
        calls = ("predict", "update", "belief")
        if lacking := [call for call in calls if not callable(getattr(self.filter, call, None))]:
            kind, methods = type(self.filter).__name__, ", ".join(lacking)
            raise FilterFailure("start", f"gave what is no filter: {kind} has no method {methods}")
        self.raw: bool = getattr(self.filter, "motion", "twist") == "imu"
        self.batched: bool = getattr(self.filter, "batched", False)
        self._batch: Shape = np.shape(task.prior.T_world_imu)[:-2]

    def feed(self, inputs: Iterable[Input]) -> Iterator[Done]:
        """Make a call for each input, in order.

        Raises:
            FilterFailure: the filter raised, or gave an innovation that is none.
        """
        predict: Callable[[Any, float], None] = self.filter.predict
        update: Callable[[Any], Innovation | None] = self.filter.update
        frame = -1
        for each in inputs:
            if isinstance(each, Frame):
                frame += 1
                name = f"update {frame}"
                innovation = self.watch(name, update, each)
                _check_innovation(name, innovation, each.readings.shape[-1], self._batch)
                yield Done(name=name, frame=frame, taken=True, innovation=innovation)
            else:
                name = f"predict {frame}"
                self.watch(name, predict, *each)
                yield Done(name=name, frame=frame + 1, taken=False)

    def belief(self, call: str, *, joint: bool = False) -> Belief:
        """What the filter holds after a call.

        Raises:
            FilterFailure: it raised, or holds what is no belief.
        """
        if joint:
            return checked(call, self.watch(call, self.filter.belief, joint=True), self._batch)
        return checked(call, self.watch(call, self.filter.belief), self._batch)

    def finish(self) -> Smoothed | None:
        """What a filter with something to do at the end knows then, None of another.

        Raises:
            FilterFailure: it raised, or gave what is no belief.
        """
        if not isinstance(self.filter, Finishing):
            return None
        found = self.watch("finish", self.filter.finish)
        smoothed = found if isinstance(found, Smoothed) else Smoothed(final=found)
        for belief in (smoothed.final, *smoothed.poses):
            checked("finish", belief, self._batch)
        return smoothed


def checked(call: str, belief: Belief, batch: Shape = ()) -> Belief:
    """The same belief, once it is known for one.

    Args:
        call: after which the filter gave it.
        belief: what it gave.
        batch: leading axes that its arrays may have.

    Raises:
        FilterFailure: it is no belief, its chart is unknown, an array is not of the shape that its
            ids call for, or not finite.
    """
    if not isinstance(belief, Belief):
        raise FilterFailure(call, f"left {type(belief).__name__}: expected a vislam.types.Belief")
    ids = belief.ids
    if (
        not isinstance(ids, np.ndarray)
        or ids.ndim != 1
        or (len(ids) and ids.dtype.kind not in "iu")
    ):
        raise FilterFailure(call, f"left `ids` that are no row of integers: {ids!r}")
    if not (callable(belief.chart) or belief.chart in CHARTS):
        raise FilterFailure(
            call, f"left the chart {belief.chart!r}: expected a function or one of {list(CHARTS)}"
        )
    m = len(ids)
    size = 3 * m if belief.pose_covariance is None else 6 + 3 * m
    arrays: dict[str, tuple[Array, Shape]] = {
        "T_world_imu": (belief.T_world_imu, (4, 4)),
        "landmarks": (belief.landmarks, (m, 3)),
    }
    if belief.pose_covariance is not None:
        arrays["pose_covariance"] = belief.pose_covariance, (6, 6)
    if np.size(belief.landmark_covariances):  # none where they are not stated
        arrays["landmark_covariances"] = belief.landmark_covariances, (m, 3, 3)
    if belief.joint_covariance is not None:
        arrays["joint_covariance"] = belief.joint_covariance, (size, size)
    for name, (array, shape) in arrays.items():
        _check_shape(call, f"left `{name}`", array, shape, batch)
        _check_finite(call, f"left `{name}`", array)
    return belief


def error_of(call: str, belief: Belief, truth: State) -> Array:
    """The error of a belief in its own chart, shape (..., n).

    Raises:
        FilterFailure: the belief is of unknown landmarks, or its chart gives no such error.
    """
    found = Watch()(call, belief.error, truth)
    size = 3 * len(belief.ids) + (0 if belief.pose_covariance is None else 6)
    _check_shape(call, "left an error", found, (size,), np.shape(found)[:-1])
    _check_finite(call, "left an error", found)
    return found


def _check_innovation(call: str, innovation: Innovation | None, rows: int, batch: Shape) -> None:
    if innovation is None:
        return
    if not isinstance(innovation, Innovation):
        kind = type(innovation).__name__
        raise FilterFailure(call, f"returned {kind}: expected an Innovation or None")
    k = np.size(innovation.ids)
    _check_shape(call, "returned `residual`", innovation.residual, (k, rows), batch)
    _check_shape(call, "returned `whitened`", innovation.whitened, (k, rows), batch)
    _check_shape(call, "returned `accepted`", innovation.accepted, (k,), batch)
    _check_finite(call, "returned `whitened`", innovation.whitened)


def _check_shape(call: str, what: str, array: object, shape: Shape, batch: Shape) -> None:
    """Refuse what is no array of numbers of a shape, with the leading axes of the batch or none."""
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "biuf":
        raise FilterFailure(call, f"{what} that is no array of numbers: {array!r}")
    if array.shape not in (shape, (*batch, *shape)):
        raise FilterFailure(call, f"{what} of shape {array.shape}, expected {(*batch, *shape)}")


def _check_finite(call: str, what: str, array: Array) -> None:
    if not np.isfinite(array).all():
        text = np.array2string(array, precision=3, threshold=20)
        raise FilterFailure(call, f"{what} that is not finite: {text}")
