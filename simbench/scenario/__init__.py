"""The scene as data: loaded from YAML, validated with the place of every fault, frozen.

`load` reads a file, `loads` text, and `Scenario` is what they give; its attributes are the keys of
the file. `TRAJECTORIES` and `LANDMARKS` say what kinds there are.
"""

from typing import TYPE_CHECKING, Any

from simbench.scenario.kinds import LANDMARKS, TRAJECTORIES

if TYPE_CHECKING:
    from simbench.scenario.loading import load, loads
    from simbench.scenario.scene import Scenario

__all__ = ["LANDMARKS", "TRAJECTORIES", "Scenario", "load", "loads"]


def __getattr__(name: str) -> Any:
    """The loader and the models when they are first asked for: they take 0.2 s."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from simbench.scenario import loading

    return getattr(loading, name)
