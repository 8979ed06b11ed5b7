"""The estimators of the paper, and variants, behind one protocol (`Filter`)."""

from vislam.filters.consistent import slam_fej, slam_inverse_depth, slam_transport
from vislam.filters.dead_reckoning import DeadReckoning
from vislam.filters.invariant import slam_invariant
from vislam.filters.iterated import slam_iterated
from vislam.filters.mapping import Mapping
from vislam.filters.parts import Parts
from vislam.filters.protocol import Factory, Filter
from vislam.filters.slam import EkfSlam, slam_constant_prior

__all__ = [
    "DeadReckoning",
    "EkfSlam",
    "Factory",
    "Filter",
    "Mapping",
    "Parts",
    "slam_constant_prior",
    "slam_fej",
    "slam_invariant",
    "slam_inverse_depth",
    "slam_iterated",
    "slam_transport",
]
