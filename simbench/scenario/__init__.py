"""The scene as data: loaded from YAML, validated with the place of every fault, frozen.

`load` reads a file, `loads` text, and `Scenario` is what they give; its attributes are the keys of
the file. `TRAJECTORIES` and `LANDMARKS` say what kinds there are.
"""

from typing import Any, get_args

from simbench.scenario.landmarks import LandmarkKind
from simbench.scenario.loading import load, loads
from simbench.scenario.scene import Scenario
from simbench.scenario.trajectories import TrajectoryKind

__all__ = ["LANDMARKS", "TRAJECTORIES", "Scenario", "load", "loads"]


def _table(union: Any) -> dict[str, str]:
    models = get_args(get_args(union)[0])
    return {
        model.model_fields["kind"].default: model.__doc__.strip().splitlines()[0]
        for model in models
    }


#: Kinds of trajectories, and a line on each.
TRAJECTORIES: dict[str, str] = _table(TrajectoryKind)
#: Kinds of landmark fields, and a line on each.
LANDMARKS: dict[str, str] = _table(LandmarkKind)
