"""The estimators of the paper, behind one protocol (`Filter`)."""

from vislam.filters.protocol import Factory, Filter

__all__ = ["Factory", "Filter"]
