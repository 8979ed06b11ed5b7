"""What a filter's name means: one of ours, one that a distribution registers, or a factory."""

import difflib
import importlib
import sys
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import cast

from simbench.errors import InputError
from vislam.filters import FILTERS, Factory

#: Distributions register a factory under a name of their own in this entry-point group.
GROUP = "simbench.filters"


def resolve(name: str) -> Factory:
    """The factory behind a name.

    Args:
        name: one of `known`, or `package.module:factory`; the working directory is searched too.

    Raises:
        InputError: there is no such filter, or it cannot be imported.
    """
    if name in FILTERS:
        return cast(Factory, FILTERS[name][1])
    registered = _registered()
    if name in registered:
        return _load(name, registered[name].value)
    if ":" in name:
        return _load(name, name)
    close = difflib.get_close_matches(name, known(), n=1)
    hint = f"Did you mean {close[0]}?" if close else f"There are {', '.join(known())}."
    raise InputError(f"--filter {name}: expected a filter's name or package.module:factory. {hint}")


def known() -> dict[str, str]:
    """The filters by name, with a line on each."""
    ours = {name: about for name, (about, _) in FILTERS.items()}
    theirs = {name: f"registered as {point.value}" for name, point in _registered().items()}
    return theirs | ours


def _registered() -> dict[str, EntryPoint]:
    return {point.name: point for point in entry_points(group=GROUP)}


def _load(name: str, value: str) -> Factory:
    module_name, _, attributes = value.partition(":")
    here = str(Path.cwd())
    sys.path.insert(0, here)
    try:
        found: object = importlib.import_module(module_name)
        for attribute in attributes.split("."):
            found = getattr(found, attribute)
    except Exception as error:
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
