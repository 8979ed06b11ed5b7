"""The dataset format of the course: `.npz` files, read with distrust and written to the byte.

A file that `write_npz` made is a plain file of the format, with keys beside it that other readers
ignore and that give the same dataset back, to the last bit.
"""

from simbench.npz.checked import dialect_of
from simbench.npz.reading import read_convention, read_npz
from simbench.npz.writing import write_npz

__all__ = ["dialect_of", "read_convention", "read_npz", "write_npz"]
