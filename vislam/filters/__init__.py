"""The estimators of the paper, behind one protocol (`Filter`)."""

from collections.abc import Mapping as _Mapping
from functools import partial
from types import MappingProxyType

from vislam.filters.dead_reckoning import DeadReckoning
from vislam.filters.mapping import Mapping
from vislam.filters.model import constant_prior
from vislam.filters.protocol import Factory, Filter
from vislam.filters.slam import EkfSlam, Parts

#: The filters by name.
FILTERS: _Mapping[str, Factory] = MappingProxyType(
    {
        "dead-reckoning": DeadReckoning,
        "mapping": Mapping,
        "mapping-truth": Mapping.on_truth,
        "slam": EkfSlam,
        "slam-constant-prior": partial(EkfSlam, parts=Parts(birth=constant_prior)),
    }
)

__all__ = ["FILTERS", "DeadReckoning", "EkfSlam", "Factory", "Filter", "Mapping", "Parts"]
