"""What passes between a filter and the world.

Frozen, keyword-only dataclasses on plain arrays. A leading ``...`` in a shape stands for an
optional batch axis: runs that share ids, times and visibility, and differ in their numbers.
"""

from vislam.types.beliefs import Belief, Innovation, Smoothed, State
from vislam.types.readings import Frame, ImuSample, PointFrame, StereoFrame, Twist
from vislam.types.told import MEMORY_BYTES, Calibration, Noise, ProcessModel, Task

__all__ = [
    "MEMORY_BYTES",
    "Belief",
    "Calibration",
    "Frame",
    "ImuSample",
    "Innovation",
    "Noise",
    "PointFrame",
    "ProcessModel",
    "Smoothed",
    "State",
    "StereoFrame",
    "Task",
    "Twist",
]
