"""How a recording was made: what it takes to make its numbers again."""

import json
import platform
from collections.abc import Mapping
from importlib.metadata import version
from typing import Any

from simbench import __version__
from simbench.dataset import Dataset

FORMAT_VERSION = 1
LIBRARY = f"simbench {__version__}; mcap {version('mcap')}; rosbags {version('rosbags')}"

#: The numbers in a recording come from these, and its bytes.
_LIBRARIES = ("numpy", "scipy", "mcap", "rosbags", "pillow")


def provenance(
    dataset: Dataset, filter_name: str | None, options: Mapping[str, Any], epoch_ns: int
) -> dict[str, str]:
    """The metadata record ``simbench``; an empty value is "none".

    Args:
        dataset: the data.
        filter_name: whose run it is; None for a dataset alone.
        options: of the run, beside what the dataset says.
        epoch_ns: what was added to the dataset's times.
    """
    origin, gate = dataset.origin, dataset.gate
    return {
        "format_version": str(FORMAT_VERSION),
        "version": __version__,
        "scenario": dataset.name,
        "seed": str(origin.seed) if origin else "",
        "run": str(origin.run) if origin else "",
        "origin_version": origin.version if origin else "",
        "filter": filter_name or "",
        "gate": "" if gate is None else repr(gate),
        "options": json.dumps(dict(options), sort_keys=True),
        "epoch_ns": str(epoch_ns),
        "python": platform.python_version(),
        **{name: version(name) for name in _LIBRARIES},
    }
