"""How much of the machine a stranger's file may claim: one limit for every reader.

A reader asks here before it allocates what a file only claims. The command line raises the limit
with ``--limit SIZE``, a program with `limited_to`:

    with limited_to(parse_size("16GB")):
        dataset = read_npz(path)
"""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import fields, is_dataclass

import numpy as np

from simbench.errors import DatasetError, InputError
from vislam.arrays import Array

#: Half as much again as the features of the largest drive that is known.
DEFAULT_BYTES = 2 * 2**30

#: Numbers of data beyond this are damage: what is computed from them overflows.
LARGEST = 1e20

_UNITS = {"": 1, "K": 2**10, "M": 2**20, "G": 2**30, "T": 2**40}
_limit_bytes = ContextVar("limit_bytes", default=DEFAULT_BYTES)


@contextmanager
def limited_to(n_bytes: int) -> Iterator[None]:
    """Let files claim up to `n_bytes` within the block."""
    token = _limit_bytes.set(n_bytes)
    try:
        yield
    finally:
        _limit_bytes.reset(token)


def limit_bytes() -> int:
    """What a file may claim now, in bytes."""
    return _limit_bytes.get()


def refuse_above_limit(where: str, what: str, n_bytes: int) -> None:
    """Hold a claim against the limit, before anything is allocated.

    Args:
        where: the file or scene, and the key or line in it.
        what: what claims, such as "an array of shape (4, 10)".
        n_bytes: how much memory it takes, or would take.

    Raises:
        DatasetError: it is above the limit; names the limit and the option.
    """
    if n_bytes > limit_bytes():
        raise DatasetError(
            f"{where}: {what} takes {format_size(n_bytes)}, above the limit of "
            f"{format_size(limit_bytes())}. If that is meant, and no damage, raise the limit with "
            "--limit SIZE."
        )


def unsound(array: Array) -> str | None:
    """What was expected and what came, of the first number that nothing can be computed with."""
    sound = np.abs(array) <= LARGEST  # not so of NaN
    if np.all(sound):
        return None
    at = np.argwhere(~sound)[0].tolist()
    place = f" at {at}" if len(at) > 1 else ""
    value = array[tuple(at)]
    expected = f"numbers up to {LARGEST:g}" if np.isfinite(value) else "finite numbers"
    return f"expected {expected}, got {value}{place}"


def beyond(value: object, name: str) -> str | None:
    """The dotted name of the first number in a dataclass that nothing can be computed with.

    Args:
        value: a dataclass, an array or a number; all else is passed over. NaN stands for a reading
            that is missing, and is allowed in fields called `points`.
        name: of the value.

    Returns:
        None where all are finite and no larger than `LARGEST`.
    """
    if is_dataclass(value):
        inner = (beyond(getattr(value, f.name), f"{name}.{f.name}") for f in fields(value))
        return next(filter(None, inner), None)
    if isinstance(value, float) or (isinstance(value, np.ndarray) and value.dtype.kind == "f"):
        sound = np.abs(value) <= LARGEST
        if name.endswith(".points"):
            sound |= np.isnan(value)
        return None if np.all(sound) else name
    return None


def parse_size(text: str) -> int:
    """A number of bytes from "500MB", "8 GB", "2GiB" or "1000"; a kilobyte has 1024.

    Raises:
        InputError: it is no size.
    """
    match = re.fullmatch(r"(\d{1,9}(?:\.\d{1,9})?) ?([KMGT]?)(?:i?B)?", text.strip(), re.IGNORECASE)
    if not match or not (n_bytes := int(float(match[1]) * _UNITS[match[2].upper()])):
        raise InputError(f"Expected a size such as 500MB or 8GB, got {text!r}.")
    return n_bytes


def format_size(n_bytes: int) -> str:
    """A number of bytes for people: "1.3 GB"."""
    for unit, factor in reversed(_UNITS.items()):
        if n_bytes >= factor:
            return f"{n_bytes / factor:.4g} {unit}B"
    return f"{n_bytes} B"
