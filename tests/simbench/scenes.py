"""Small scenes for the tests of simulator and files, and what compares datasets."""

from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from simbench.scenario import Scenario

#: A scene that uses every kind of reading, with no two sigmas alike.
RICH = {
    "name": "rich",
    "seed": 3,
    "duration_s": 4.0,
    "rate_hz": 10.0,
    "time_jitter": 0.5,
    "trajectory": {"kind": "figure8", "size_m": [8.0, 5.0], "laps": 1, "roll_deg": 4.0},
    "landmarks": {"kind": "path", "count": 40},
    "rig": {"imu_cam": {"rotvec_deg": [3.0, -5.0, 8.0]}},
    "imu": {
        "velocity": {"sigma": [0.1, 0.2, 0.3], "bias_sigma": 0.05, "bias_walk": 0.01},
        "angular_velocity": {"sigma": [0.01, 0.02, 0.03], "bias_sigma": 0.004, "bias_walk": 0.001},
        "raw": {"rate_hz": 100.0},
    },
    "camera": {
        "sigma_px": [0.5, 0.8, 1.1, 1.4],
        "dropout": 0.1,
        "half_missing": 0.1,
        "outliers": {"share": 0.1},
        "walls": [[2.0, 0.5, 3.0, 0.5, 2.0]],
        "tracks": {"median_frames": 8, "min_frames": 2, "max_frames": 30},
    },
    "told": {
        "rotation_error_deg": [0.1, -0.2, 0.3],
        "translation_error_m": [0.01, 0.02, -0.03],
        "baseline_scale": 1.01,
        "pixel_sigma_scale": 1.5,
        "twist_sigma_scale": 0.7,
    },
    "filter": {"gate": 0.999},
}
#: As much motion, and no chance but white noise.
PLAIN = {
    "name": "plain",
    "duration_s": 10.0,
    "trajectory": {"kind": "figure8", "size_m": [12.0, 8.0], "laps": 1, "roll_deg": 4.0},
}


def scene(base: dict[str, Any] = PLAIN, **changes: Any) -> Scenario:
    """A scene with keys changed; the rest of a section stays, unless its `kind` is another."""
    return Scenario.model_validate(_merged(base, changes))


def _merged(base: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, new in changes.items():
        old = base.get(key)
        both = isinstance(old, dict) and isinstance(new, dict)
        if both and new.get("kind") in (None, old.get("kind")):
            merged[key] = _merged(old, new)
        else:
            merged[key] = new
    return merged


def differences(a: Any, b: Any, path: str = "") -> list[str]:
    """The fields in which two datasets differ, to the bit."""
    if is_dataclass(a) and type(a) is type(b):
        return [
            line
            for field in fields(a)
            for line in differences(
                getattr(a, field.name), getattr(b, field.name), f"{path}.{field.name}"
            )
        ]
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        same = a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    else:
        same = a == b
    return [] if same else [path]
