"""Real filter mistakes, each as a change of the production filter that is right without it.

What a bench is worth is how many of these it catches. `slam+NAME` is the filter with the bug in it,
on the base where its clean form passes; `slam-invariant+NAME`, or another of `PARTS`, puts it into
that one. The tables name what they make and import none of it.
"""

import difflib
import importlib
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from simbench.bugs.bug import CHECKS, Bug, Trace
from simbench.bugs.catalogue import CATALOGUE
from simbench.bugs.further import FURTHER
from simbench.errors import InputError

if TYPE_CHECKING:
    from vislam.filters import Factory

__all__ = ["BUGS", "CHECKS", "Bug", "Trace", "mutant"]

#: Every bug by name.
BUGS = MappingProxyType(CATALOGUE | FURTHER)

#: Where the parts of a base filter are.
PARTS = MappingProxyType(
    {
        "slam": "vislam.filters.parts:PAPER",
        "slam-fej": "vislam.filters.consistent:FIRST_ESTIMATES",
        "slam-transport": "vislam.filters.consistent:TRANSPORTED",
        "slam-invariant": "vislam.filters.invariant:RIGHT_INVARIANT",
        "slam-iterated": "vislam.filters.iterated:ITERATED",
        "slam-inverse-depth": "vislam.filters.consistent:INVERSE_DEPTH",
    }
)


def mutant(name: str) -> "Factory":
    """The factory of a filter with a bug.

    Args:
        name: `slam+BUG` for the bug's own base, or with another base of `PARTS`, as `slam-fej+BUG`.

    Raises:
        InputError: there is no such base, or no such bug.
    """
    base, _, bug = name.partition("+")
    for what, given, there in (("base filter", base, PARTS), ("bug", bug, BUGS)):
        if given not in there:
            close = difflib.get_close_matches(given, there, n=1)
            hint = f"Did you mean {close[0]}?" if close else "`simbench list bugs` names all."
            if what == "base filter" and not close:
                hint = f"There are {', '.join(PARTS)}."
            raise InputError(f"--filter {name}: expected BASE+BUG, got no {what} {given!r}. {hint}")
    parts = PARTS[BUGS[bug].base if base == "slam" else base]
    return partial(_load(BUGS[bug].make), parts=_load(parts))


def _load(place: str) -> Any:
    module, _, name = place.partition(":")
    return getattr(importlib.import_module(module), name)
