"""Pictures of runs and of what judges them, for people and for papers.

Each function returns a matplotlib `Figure` that no global state knows of: show it in a notebook,
or `save` it. Line styles and markers carry the meaning as well as the colours (Okabe and Ito's,
which the colour-blind can tell apart), so that a grey print can be read.
"""

from simbench.figures.drawing import save, svg
from simbench.figures.judging import bugs, decay, spread, within_bands
from simbench.figures.runs import (
    consistency,
    consistency_over_time,
    errors,
    nees,
    trajectories,
)

__all__ = [
    "bugs",
    "consistency",
    "consistency_over_time",
    "decay",
    "errors",
    "nees",
    "save",
    "spread",
    "svg",
    "trajectories",
    "within_bands",
]
