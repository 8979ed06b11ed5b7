"""What a filter is, to everything that runs or judges one."""

from collections.abc import Callable
from typing import Protocol, TypeAlias, runtime_checkable

from vislam.types import Belief, Innovation, Smoothed, StereoFrame, Task, Twist


class Filter(Protocol):
    """A filter that can be run.

    Calls come in time order: ``update`` of frame 0, ``predict`` over [t_0, t_1), ``update`` of
    frame 1, and so on. A filter owns its arrays and changes them in place; what it hands out is a
    snapshot that later calls leave alone.

    Optional members: a class attribute ``motion = "imu"`` asks for raw `ImuSample`s in place of
    twists (several a frame); a class attribute ``batched = True`` says that prior, twists and
    pixels may carry a leading batch axis, which makes an audit much faster; a method ``finish() ->
    Belief | Smoothed`` is called once, last, of a filter that has something to do at the end, and
    returns the final belief over all landmarks, with past poses where `Task.smooth` asks for them.
    """

    def predict(self, motion: Twist, dt: float) -> None:
        """Move the belief over `dt` seconds."""

    def update(self, frame: StereoFrame) -> Innovation | None:
        """Take in a frame; None where the filter has no use for one.

        Of a scene with a point sensor the frames are `vislam.types.PointFrame`s.
        """

    def belief(self, joint: bool = False) -> Belief:
        """Pose and the landmarks still in the state; with `joint` the whole covariance."""


@runtime_checkable
class Finishing(Protocol):
    """A filter with work at the end."""

    def finish(self) -> Belief | Smoothed:
        """The final belief, over all landmarks that were ever in the state."""


#: Makes a filter from what it is told.
Factory: TypeAlias = Callable[[Task], Filter]
