"""What a filter's name means: one of ours, possibly with a bug, a registered one, or a factory."""

import difflib
import importlib
import sys
from importlib.metadata import entry_points
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

from simbench.bugs import mutant
from simbench.errors import InputError

if TYPE_CHECKING:
    from vislam.filters import Factory

#: Ours: a line on each, and where its factory is. Nothing is imported before it is asked for.
FILTERS = MappingProxyType(
    {
        "dead-reckoning": (
            "IMU localisation by EKF prediction, the paper's III.A",
            "vislam.filters:DeadReckoning",
        ),
        "mapping": (
            "landmarks on the dead-reckoned trajectory, the paper's III.B",
            "vislam.filters:Mapping",
        ),
        "mapping-truth": (
            "landmarks on the true trajectory",
            "vislam.filters:Mapping.on_truth",
        ),
        "slam": (
            "pose and landmarks with one covariance, the paper's III.C",
            "vislam.filters:EkfSlam",
        ),
        "slam-constant-prior": (
            "slam with the paper's start of a landmark, a constant covariance: inconsistent",
            "vislam.filters:slam_constant_prior",
        ),
        "slam-fej": (
            "slam with first-estimates Jacobians, in H and in F",
            "vislam.filters:slam_fej",
        ),
        "slam-transport": (
            "slam whose covariance is carried along when an update moves the estimate",
            "vislam.filters:slam_transport",
        ),
        "slam-invariant": (
            "slam with the right-invariant error of pose and landmarks",
            "vislam.filters:slam_invariant",
        ),
        "slam-inverse-depth": (
            "slam-transport whose landmarks move along their inverse depth, for far ones",
            "vislam.filters:slam_inverse_depth",
        ),
        "slam-iterated": (
            "slam-transport whose update is iterated, for large innovations",
            "vislam.filters:slam_iterated",
        ),
    }
)

#: Distributions register a factory under a name of their own in this entry-point group.
GROUP = "simbench.filters"


def resolve(name: str) -> "Factory":
    """The factory behind a name.

    Args:
        name: one of `known`, `slam+BUG` (`simbench.bugs.mutant`), or `package.module:factory`; the
            working directory is searched too.

    Raises:
        InputError: there is no such filter, or it cannot be imported.
    """
    if name in FILTERS:
        return _load(name, FILTERS[name][1])
    registered = _registered()
    if name in registered:
        return _load(name, registered[name])
    if ":" in name:
        return _load(name, name)
    if "+" in name:
        return mutant(name)
    close = difflib.get_close_matches(name, known(), n=1)
    hint = f"Did you mean {close[0]}?" if close else f"There are {', '.join(known())}."
    raise InputError(f"--filter {name}: expected a filter's name or package.module:factory. {hint}")


def known() -> dict[str, str]:
    """The filters by name, with a line on each."""
    ours = {name: about for name, (about, _) in FILTERS.items()}
    theirs = {name: f"registered as {value}" for name, value in _registered().items()}
    return theirs | ours


def _registered() -> dict[str, str]:
    return {point.name: point.value for point in entry_points(group=GROUP)}


def _load(name: str, value: str) -> "Factory":
    module_name, _, attributes = value.partition(":")
    here = str(Path.cwd())
    sys.path.insert(0, here)
    try:
        found: object = importlib.import_module(module_name)
        for attribute in attributes.split("."):
            found = getattr(found, attribute)
    except Exception as error:  # a stranger's module, as it is imported
        raise InputError(
            f"--filter {name}: expected an importable module and a factory in it, "
            f"got {type(error).__name__}: {error}."
        ) from error
    finally:
        sys.path.remove(here)
    if not callable(found):
        raise InputError(
            f"--filter {name}: expected a callable that takes a vislam.types.Task and returns a "
            f"filter, got {type(found).__name__}."
        )
    return found
