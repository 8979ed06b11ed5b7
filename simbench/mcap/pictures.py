"""What a camera saw, drawn: each feature a square, its colour what the filter made of it."""

import io
from enum import IntEnum

import numpy as np
from PIL import Image

from simbench.dataset import Dataset, Sightings
from vislam.arrays import Array, IntArray
from vislam.camera import StereoRig
from vislam.types import Innovation, StereoFrame


class Fate(IntEnum):
    """What became of a feature; its place in `PALETTE`."""

    UNTESTED = 1  # no filter, or the landmark was not known before
    USED = 2
    REFUSED = 3  # by the gate, or because its pixels are not valid


#: Red, green, blue of the background and of each fate; four colours are two bits a pixel.
PALETTE = bytes.fromhex("141418 ebebeb 3cd25a ff463c")
_BITS = 2
#: Outside every image.
FAR_PX = 2.0**20
#: The largest side, where only the features say how large an image is: a wild one says anything.
#: No image has more pixels than a square of it.
MOST_PX = 4096
_SQUARE = np.argwhere(np.ones((7, 7))) - 3


def fates(frame: StereoFrame, innovation: Innovation | None) -> IntArray:
    """The `Fate` of each feature of a frame, shape (n,)."""
    fate = np.full(len(frame.ids), Fate.UNTESTED, np.int64)
    if innovation is not None:
        used, refused = innovation.ids[innovation.accepted], innovation.ids[~innovation.accepted]
        fate[np.isin(frame.ids, used)] = Fate.USED
        fate[np.isin(frame.ids, np.concatenate([refused, innovation.skipped]))] = Fate.REFUSED
    return fate


def drawable(dataset: Dataset) -> bool:
    """Whether there is something to draw, on images of a known and a usual size."""
    width, height = size_px(dataset)
    return dataset.sightings is not None and 0 < width * height <= MOST_PX**2


def draw(pixels: Array, fate: IntArray, size_px: tuple[int, int]) -> bytes:
    """A PNG of the features of one image.

    Args:
        pixels: u, v, shape (n, 2); not drawn where a coordinate is -1, "not seen".
        fate: shape (n,).
        size_px: width and height.
    """
    seen = ((pixels != -1) & (np.abs(pixels) < FAR_PX)).all(axis=-1)
    width, height = size_px
    picture = np.zeros((height, width), np.uint8)
    centres = np.rint(pixels[seen]).astype(int)
    columns, rows = (centres[:, None] + _SQUARE).transpose(2, 0, 1)
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    colours = np.broadcast_to(fate[seen, None], inside.shape)
    picture[rows[inside], columns[inside]] = colours[inside]
    image = Image.fromarray(picture)
    image.putpalette(PALETTE)
    file = io.BytesIO()
    image.save(file, "PNG", bits=_BITS)
    return file.getvalue()


def size_px(dataset: Dataset) -> tuple[int, int]:
    """Width and height of the images; where nobody says, what holds the features, or (0, 0)."""
    rig, sightings = dataset.calibration.rig, dataset.sightings
    if isinstance(rig, StereoRig) and rig.image_px is not None:
        width, height = rig.image_px
    elif not isinstance(sightings, Sightings):
        width, height = 0, 0
    else:
        corner = sightings.pixels.reshape(-1, 2).max(axis=0, initial=-1)
        width, height = np.minimum(np.ceil(corner) + 1, MOST_PX)
    return int(width), int(height)
