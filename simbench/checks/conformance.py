"""All checks by name: the conformance suite of a filter.

A check takes a filter's factory, and a short drive where another scene than its own is wanted, and
returns a result with its reason. Nothing is imported before a check is asked for.
"""

import difflib
import importlib
from types import MappingProxyType
from typing import TYPE_CHECKING

from simbench.errors import InputError

if TYPE_CHECKING:
    from simbench.checks.result import Check, CheckResult
    from simbench.checks.short_drive import ShortDrive
    from vislam.filters import Factory

#: A line on each check, by the module it lies in; its function is its name with underscores.
_BY_MODULE = {
    "exact": {
        "exact-audit": "the covariance claimed is that of the errors, to first order, at each call",
    },
    "laws": {
        "move-the-world": "everything moved by a rigid motion: the estimates move along",
        "rename-the-landmarks": "other ids: the same map under other names",
        "shift-the-clock": "all times later: nothing changes",
        "reorder-the-features": "a frame's features in another order: nothing changes",
        "run-twice": "the same data again: the same to the last bit",
        "keep-what-was-handed-out": "a belief is a snapshot that later calls leave alone",
        "divide-the-frame": "a frame's features in two calls: the same, to first order in noise",
        "hide-a-landmark": "a landmark that is never seen is as good as none",
        "ignore-an-empty-frame": "a frame of features all at -1 changes nothing but the clock",
        "ignore-a-half-missing-feature": "a feature with some coordinates at -1 is as good as none",
        "ignore-what-a-mask-hides": "what a half-missing feature still has never reaches the state",
        "state-covariances": "symmetric, no eigenvalue below zero, blocks equal to the joint one's",
    },
    "vague": {
        "find-the-place": "covariances stay covariances where a known map tells a vague start all",
    },
    "known": {
        "keep-the-known-map": "landmarks that are known stay where they are as the pose turns",
    },
    "gate": {
        "refuse-as-often-as-told": "a gate of probability p refuses 1 - p of right sightings",
    },
    "jacobians": {
        "jacobians": "F, H and G that a filter shows are those of their definitions",
        "follow-the-records": "the covariance is what a filter's records make of the one before",
        "move-by-the-correction": "an update moves the estimate by what its records say, K r",
    },
    "structure": {
        "null-space": "F, H and G that a filter shows keep the motions of the world unobservable",
        "nullity": "of all that a filter observed, six directions stay open",
        "gauge-information": "no call adds information along the motions of the world",
    },
    "rest": {
        "rest-teaches-nothing": "at rest, sightings of a new landmark leave the pose as it is",
        "a-step-teaches-nothing": "a step between sightings does not make the pose surer",
    },
}

#: The checks, with a line on each.
CHECKS = MappingProxyType(
    {name: line for checks in _BY_MODULE.values() for name, line in checks.items()}
)
#: Those that have a scene of their own, or judge by chance: to search scenes with them is no use.
NOT_HUNTED = frozenset(
    {"refuse-as-often-as-told", "rest-teaches-nothing", "a-step-teaches-nothing"}
)
_MODULES = {name: module for module, checks in _BY_MODULE.items() for name in checks}


def resolve(name: str) -> "Check":
    """The check of a name.

    Raises:
        InputError: there is no such check.
    """
    if name not in CHECKS:
        close = difflib.get_close_matches(name, CHECKS, n=1)
        hint = f"Did you mean {close[0]}?" if close else f"There are {', '.join(CHECKS)}."
        raise InputError(f"Expected the name of a check, got {name!r}. {hint}")
    module = importlib.import_module(f"simbench.checks.{_MODULES[name]}")
    found: Check = getattr(module, name.replace("-", "_"))
    return found


def run_all(factory: "Factory", drive: "ShortDrive | None" = None) -> tuple["CheckResult", ...]:
    """Run every check.

    Args:
        factory: makes the filter.
        drive: the scene, by default each check's own.

    Returns:
        A result for each, in the order of `CHECKS`; those that do not apply are marked skipped.
    """
    return tuple(resolve(name)(factory, drive) for name in CHECKS)
