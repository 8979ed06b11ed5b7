"""The estimators of the paper, behind one protocol (`Filter`)."""

from functools import partial
from types import MappingProxyType

from vislam.filters.dead_reckoning import DeadReckoning
from vislam.filters.mapping import Mapping
from vislam.filters.model import constant_prior
from vislam.filters.protocol import Factory, Filter
from vislam.filters.slam import EkfSlam, Parts

_WITH_CONSTANT_PRIOR = partial(EkfSlam, parts=Parts(birth=constant_prior))

#: What there is: a line on each filter and its factory, by name.
FILTERS = MappingProxyType(
    {
        "dead-reckoning": ("IMU localisation by EKF prediction, III.A", DeadReckoning),
        "mapping": ("landmarks on the dead-reckoned trajectory, III.B", Mapping),
        "mapping-truth": ("landmarks on the true trajectory, III.B", Mapping.on_truth),
        "slam": ("pose and landmarks with one covariance, III.C", EkfSlam),
        "slam-constant-prior": (
            "slam with the paper's start of a landmark, a constant covariance: inconsistent",
            _WITH_CONSTANT_PRIOR,
        ),
    }
)

__all__ = ["FILTERS", "DeadReckoning", "EkfSlam", "Factory", "Filter", "Mapping", "Parts"]
