"""Numbers of a run: errors against the truth, consistency, and the table of `metrics.json`."""

from simbench.metrics.consistency import (
    DIVERGED,
    RANK_TOLERANCE,
    LandmarkErrors,
    Whiteness,
    chi_square_band,
    landmark_errors,
    nees,
    nis,
    pose_nees,
    whiteness,
)
from simbench.metrics.table import POSE_ERRORS, Metrics, metrics
from simbench.metrics.trajectory import Alignment, PoseErrors, align, ate, path_length, rmse, rpe

__all__ = [
    "DIVERGED",
    "POSE_ERRORS",
    "RANK_TOLERANCE",
    "Alignment",
    "LandmarkErrors",
    "Metrics",
    "PoseErrors",
    "Whiteness",
    "align",
    "ate",
    "chi_square_band",
    "landmark_errors",
    "metrics",
    "nees",
    "nis",
    "path_length",
    "pose_nees",
    "rmse",
    "rpe",
    "whiteness",
]
