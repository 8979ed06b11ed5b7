"""A test bench for visual-inertial filters."""

from vislam import __version__

__all__ = ["__version__"]
