"""Reads back what a filter made of the data, without running it again."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from simbench.dataset import Dataset
from simbench.errors import DatasetError
from simbench.mcap import messages as m
from simbench.mcap.reader import Contents, dataset_of, read_contents
from simbench.run import RunRecord, Step
from vislam.arrays import Array, IntArray
from vislam.lie import so3
from vislam.types import Belief


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedRun:
    """A run as its recording has it.

    Attributes:
        record: poses, their covariances and the final map; no innovations, no wall-clock time. The
            error of a pose is that of ROS, `map_axes_error`.
        nees: of the pose at each frame, in the filter's own chart; NaN where there is none, shape
            (T,).
        nis, nis_dof: at each frame, zero of zero where there is none, shape (T,).
        metrics: as they were written at the end; empty where the run did not come to it.
    """

    record: RunRecord
    nees: Array
    nis: Array
    nis_dof: IntArray
    metrics: dict[str, Any]


def read_run_mcap(path: Path | str) -> RecordedRun:
    """The run in a recording, as far as it got.

    Raises:
        DatasetError: as `read_dataset_mcap`; or the recording holds no run.
    """
    contents = read_contents(Path(path))
    dataset = dataset_of(contents)
    name = contents.metadata["simbench"]["filter"]
    if not contents.messages.get("/estimate/odometry"):
        raise DatasetError(
            f"{path}: expected the recording of a run, got one of a dataset alone. Run a filter on "
            f"it first: simbench run {path}"
        )
    try:
        return _run(contents, dataset, name)
    except Exception as error:  # whatever a damaged message or attachment makes its parser raise
        raise DatasetError(f"{path}: the recording is damaged: {error!r}.") from error


def map_axes_error(T_hat: Array, m_hat: Array, T: Array, m_true: Array) -> Array:
    """The error whose covariance ROS holds: p_true - p, a turn about the map's axes, m_true - m."""
    R = T[..., :3, :3] @ np.swapaxes(T_hat[..., :3, :3], -1, -2)
    of_map = (m_true - m_hat).reshape(*m_hat.shape[:-2], 3 * m_hat.shape[-2])
    return np.concatenate([T[..., :3, 3] - T_hat[..., :3, 3], so3.log(R), of_map], axis=-1)


def _run(contents: Contents, dataset: Dataset, name: str) -> RecordedRun:
    beliefs = _beliefs(contents, "/estimate/odometry")[: len(dataset)]
    ids, landmarks = _last_map(contents)
    record = RunRecord(
        dataset=dataset,
        filter=name,
        steps=tuple(Step(frame=i, belief=b, innovation=None) for i, b in enumerate(beliefs)),
        final=replace(beliefs[-1], ids=ids, landmarks=landmarks),
        wall_s=float("nan"),
        smoothed=tuple(_beliefs(contents, "/smoothed/odometry")) or None,
    )
    stamps = contents.messages["/estimate/odometry"][: len(beliefs)]
    frames = {ns: i for i, (ns, _) in enumerate(stamps)}
    nees, nees_dof = _series(contents, "/consistency/nees", frames)
    nis, nis_dof = _series(contents, "/consistency/nis", frames)
    return RecordedRun(
        record=record,
        nees=np.where(nees_dof > 0, nees, np.nan),
        nis=nis,
        nis_dof=nis_dof,
        metrics=json.loads(contents.attachments.get("metrics.json", b"{}")),
    )


def _beliefs(contents: Contents, topic: str) -> list[Belief]:
    """The poses of a topic, with covariances unless they are zero throughout: not estimated."""
    poses = [message.pose for message in contents.decoded(topic)]
    known = any(pose.covariance.any() for pose in poses)
    return [
        Belief(
            T_world_imu=_matrix(pose.pose),
            pose_covariance=pose.covariance.reshape(6, 6) if known else None,
            chart=map_axes_error,
        )
        for pose in poses
    ]


def _matrix(pose: m.Message) -> Array:
    """The transform of a pose, shape (4, 4)."""
    p, q = pose.position, pose.orientation
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
    T[:3, 3] = p.x, p.y, p.z
    return T


def _last_map(contents: Contents) -> tuple[IntArray, Array]:
    """Ids (m,) and positions (m, 3) of the last map, in single precision as it was written."""
    clouds = contents.messages.get("/estimate/landmarks")
    if not clouds:
        return np.empty(0, np.int64), np.empty((0, 3))
    cloud = m.from_cdr(clouds[-1][1], contents.types["/estimate/landmarks"])
    rows = cloud.data.reshape(cloud.width, cloud.point_step)
    points, ids = rows[:, :12].copy().view("<f4"), rows[:, 12:16].copy().view("<u4")
    return ids[:, 0].astype(np.int64), points.astype(float)


def _series(contents: Contents, topic: str, frames: Mapping[int, int]) -> tuple[Array, IntArray]:
    """A statistic and its degrees of freedom at each frame, zero of zero where there is none."""
    value, dof = np.zeros(len(frames)), np.zeros(len(frames), np.int64)
    messages = contents.messages.get(topic, ())
    for (ns, _), message in zip(messages, contents.decoded(topic), strict=True):
        if (i := frames.get(ns)) is not None:
            value[i], dof[i] = message.value, message.dof
    return value, dof
