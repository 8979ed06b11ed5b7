"""The dataset format of the course, in every dialect: read with distrust and written to the byte.

A file that `write_npz` made is a plain file of the format, with keys beside it that other readers
ignore and that give the same dataset back: to the last bit where the extrinsics are written as they
are held (the default), otherwise up to the rounding of an inverse.
"""

from simbench.npz.checked import dialect_of
from simbench.npz.dialects import Dialect
from simbench.npz.reading import read_convention, read_npz
from simbench.npz.writing import write_npz

__all__ = ["Dialect", "dialect_of", "read_convention", "read_npz", "write_npz"]
