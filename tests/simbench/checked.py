"""Filters with a planted fault, and wrappers that are all a judge sees of them."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from vislam.filters import EkfSlam, Parts
from vislam.filters.protocol import Factory
from vislam.types import Belief


def with_parts(**parts: object) -> Factory:
    return partial(EkfSlam, parts=replace(Parts(), **parts))


class Wrapped:
    """A filter behind the protocol alone: no records, no batch axis.

    `predict`, `frame` and `belief` change what goes in and out.
    """

    def __init__(
        self,
        filter_,
        *,
        frame: Callable = lambda frame: frame,
        twist: Callable = lambda twist: twist,
        belief: Callable[[Belief], Belief] = lambda belief: belief,
        innovations: bool = True,
    ) -> None:
        self.filter, self.frame, self.twist = filter_, frame, twist
        self.changed, self.innovations = belief, innovations

    def predict(self, motion, dt):
        self.filter.predict(self.twist(motion), dt)

    def update(self, frame):
        innovation = self.filter.update(self.frame(frame))
        return innovation if self.innovations else None

    def belief(self, joint=False):
        return self.changed(self.filter.belief(joint))


def wrapped(factory: Factory, **changes: object) -> Factory:
    return lambda task: Wrapped(factory(task), **changes)


def without_covariance(belief: Belief) -> Belief:
    return replace(
        belief,
        pose_covariance=None,
        landmark_covariances=np.empty((0, 3, 3)),
        joint_covariance=None,
    )
