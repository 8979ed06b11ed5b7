"""The kinds of landmark fields that a scene can name, and their keys.

Landmark i does not depend on `count`.
"""

from pathlib import Path
from typing import Annotated, Literal, TypeAlias

import numpy as np
from pydantic import Field, field_validator

from simbench.errors import DatasetError
from simbench.files import format_rows, parse_rows, read_text, size_of
from simbench.limits import refuse_above_limit
from simbench.scenario.named import Named
from simbench.scenario.values import (
    Count,
    NonNegative,
    Number,
    Point,
    Positive,
    Range,
    Section,
    WordOr,
    fault,
)
from vislam.arrays import Array

#: What a byte of an array of landmarks takes as text, and while that is read.
BYTES_PER_LANDMARK = 128
#: A point, or `path`: the middle of the box that holds the path.
Center: TypeAlias = WordOr[Literal["path"], Point]


class Box(Section):
    """Evenly in a box whose sides are along the world's axes."""

    kind: Literal["box"] = "box"
    count: Count = 100
    size_m: tuple[NonNegative, NonNegative, NonNegative] = (30.0, 30.0, 6.0)
    center_m: Center = "path"


class Shell(Section):
    """Evenly between two spheres."""

    kind: Literal["shell"] = "shell"
    count: Count = 100
    radius_m: Range = (5.0, 12.0)
    center_m: Center = "path"

    @field_validator("radius_m")
    @classmethod
    def _not_negative(cls, value: tuple[float, float]) -> tuple[float, float]:
        if value[0] < 0:
            raise fault("expected radii of at least 0, got {got}", got=value[0])
        return value


class Walls(Section):
    """On two upright walls, to the left and to the right of the path: a corridor."""

    kind: Literal["walls"] = "walls"
    count: Count = 150
    lateral_m: Positive = 2.0
    height_m: Range = (-1.2, 1.5)
    ahead_m: NonNegative = 10.0


class Ground(Section):
    """On the level ground below the path, and margin_m around it."""

    kind: Literal["ground"] = "ground"
    count: Count = 200
    height_m: Number = -1.5
    margin_m: NonNegative = 10.0


class AlongPath(Section):
    """Beside the path on both sides, and ahead_m beyond its end."""

    kind: Literal["path"] = "path"
    count: Count = 60
    lateral_m: Range = (1.5, 8.0)
    height_m: Range = (-1.5, 3.0)
    ahead_m: NonNegative = 10.0


class LandmarkFile(Named):
    """Positions in the world from a file: x y z a line, or commas between, or a .npy array."""

    kind: Literal["file"] = "file"

    @classmethod
    def read(cls, path: Path) -> str:
        """As text, x y z a line."""
        if path.suffix == ".npy":
            return format_rows(_load_npy(path))
        return format_rows(parse_rows(read_text(path), 3, str(path)))

    @field_validator("text")
    @classmethod
    def _readable(cls, value: str) -> str:
        try:
            parse_rows(value, 3, "text")
        except DatasetError as error:
            raise fault("{error}", error=error) from error
        return value


def _load_npy(path: Path) -> Array:
    refuse_above_limit(str(path), "text of these landmarks", BYTES_PER_LANDMARK * size_of(path))
    try:
        # Mapped: a header that promises more than the file holds is refused, not allocated.
        points = np.array(np.load(path, mmap_mode="r", allow_pickle=False), float)
    except (OSError, ValueError, TypeError, EOFError) as error:
        raise DatasetError(f"{path}: expected an array of numbers: {error}.") from error
    if points.ndim != 2 or points.shape[1] != 3 or not len(points) or not np.isfinite(points).all():
        raise DatasetError(
            f"{path}: expected finite numbers of shape (n, 3), got shape {points.shape}."
        )
    return points


LandmarkKind: TypeAlias = Annotated[
    Box | Shell | Walls | Ground | AlongPath | LandmarkFile, Field(discriminator="kind")
]
