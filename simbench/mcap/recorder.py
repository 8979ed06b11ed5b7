"""Writes recordings, while a run goes on or of a dataset alone."""

from bisect import bisect_right
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import IO, Any

import numpy as np
from mcap.writer import Writer

from simbench.dataset import Dataset, Truth
from simbench.files import replacing
from simbench.mcap import attachments, pictures
from simbench.mcap import messages as m
from simbench.mcap.axes import covariance_about_map_axes
from simbench.mcap.provenance import LIBRARY, provenance
from simbench.mcap.times import SECOND_NS, epoch_ns, spaced
from simbench.metrics import chi_square_band, nees
from simbench.run import RunRecord, Step
from vislam.camera import StereoRig
from vislam.types import Belief, Innovation, PointFrame, StereoFrame

#: Written once.
LATCHED = {"/tf_static", "/ground_truth/path", "/ground_truth/landmarks", "/smoothed/path"}

#: Features are drawn at most this often.
PICTURE_SPACING_NS = SECOND_NS // 20


@contextmanager
def record_to(
    path: Path | str,
    dataset: Dataset,
    filter_name: str | None = None,
    options: Mapping[str, Any] = MappingProxyType({}),
) -> Iterator["Recorder"]:
    """Open a recording; it stands at `path` once the block has succeeded.

    Until then it is called `path` with ``.partial`` behind it and is on disk up to the last
    simulated second, so what a killed run leaves can be read. A block that raises leaves nothing.

        with record_to(path, dataset, "slam") as recorder:
            record = run(dataset, factory, on_step=recorder.step)
            recorder.finish(record, metrics(record))

    Args:
        path: of the file.
        dataset: the data, and the truth where it is known.
        filter_name: whose run is recorded; None for a dataset alone.
        options: of the run, beside what the dataset says: values that JSON holds.

    Raises:
        DatasetError: a time of the dataset is no ROS stamp.
        OutputError: the operating system refused.
    """
    with replacing(Path(path)) as partial, partial.open("wb") as stream:
        recorder = Recorder(stream, dataset, filter_name, options)
        yield recorder
        recorder.close()


def write_dataset_mcap(path: Path | str, dataset: Dataset) -> None:
    """Record a dataset alone: readings, and the truth where it is known.

    Raises:
        DatasetError, OutputError: as `record_to`.
    """
    with record_to(path, dataset) as recorder:
        for frame in range(len(dataset)):
            recorder.frame(frame)


class Recorder:
    """A recording in the making; `record_to` gives one."""

    def __init__(
        self,
        stream: IO[bytes],
        dataset: Dataset,
        filter_name: str | None,
        options: Mapping[str, Any],
    ) -> None:
        """Write all that is known before the first frame."""
        imu, offset_ns = dataset.imu, epoch_ns(dataset)
        self._dataset, self._filter = dataset, filter_name
        self._made_by = provenance(dataset, filter_name, options, offset_ns)
        self._stamps_ns: list[int] = (dataset.times_ns + offset_ns).tolist()
        self._imu_ns: list[int] = [] if imu is None else (imu.times_ns + offset_ns).tolist()
        self._imu_written = 0
        self._start_ns = min(self._stamps_ns[:1] + self._imu_ns[:1])
        self._flush_ns = self._start_ns + SECOND_NS
        self._slow_frames = spaced(self._stamps_ns, _path_spacing_ns(self._stamps_ns))
        self._size_px = pictures.size_px(dataset)
        self._drawn_frames = set[int]()
        if pictures.drawable(dataset):
            self._drawn_frames = spaced(self._stamps_ns, PICTURE_SPACING_NS)
        self._estimated_path: list[m.Message] = []
        self._true_path: list[m.Message] = []
        self._channels: dict[str, Any] = {}
        self._schemas: dict[str, Any] = {}
        self._cameras = {
            f"/cam{i}/camera_info": m.camera_info(0, rig, self._size_px, right=bool(i))
            for i in (0, 1)
            if isinstance(rig := dataset.calibration.rig, StereoRig)
        }
        # Some methods of Writer carry no types. Its check sum over all finds damage to attachments.
        self._writer: Any = Writer(stream, enable_data_crcs=True)
        self._writer.start("ros2", LIBRARY)
        self._write_head()

    def frame(self, frame: int, innovation: Innovation | None = None) -> None:
        """Write the readings and the truth of a frame; the pictures show what a filter used."""
        ns = self._stamps_ns[frame]
        if ns >= self._flush_ns:
            self._writer.flush()
            self._flush_ns += SECOND_NS * (1 + (ns - self._flush_ns) // SECOND_NS)
        self._write_imu(until=bisect_right(self._imu_ns, ns))
        self._write_readings(ns, frame)
        features = self._dataset.frame(frame)
        if frame in self._drawn_frames and isinstance(features, StereoFrame):
            self._write_pictures(ns, features, innovation)
        if self._dataset.truth is not None:
            self._write_truth(ns, frame, self._dataset.truth)

    def step(self, step: Step) -> None:
        """Write a frame and what the filter made of it: the `on_step` of a run."""
        ns = self._stamps_ns[step.frame]
        self.frame(step.frame, step.innovation)
        self._write_estimate(ns, step)
        self._write_consistency(ns, step)

    def finish(self, record: RunRecord, metrics: Mapping[str, Any]) -> None:
        """Write what is known at the end of a run: the whole map, smoothed poses, the metrics."""
        end_ns = self._stamps_ns[record.steps[-1].frame]
        self._write_map(end_ns, record.final)
        if record.smoothed is not None:
            self._write_smoothed(end_ns, record.smoothed)
        self._attach("metrics.json", "application/json", attachments.dump_metrics(metrics))

    def close(self) -> None:
        """Write what is left, the mark of a whole recording, and the index."""
        self._write_imu(until=len(self._imu_ns))
        self._writer.flush()  # else the mark would stand before the last messages
        self._write_metadata(finished=True)
        self._writer.finish()

    def _write_head(self) -> None:
        ns, dataset, truth = self._start_ns, self._dataset, self._dataset.truth
        self._write_metadata(finished=False)
        if dataset.origin is not None:
            text = dataset.origin.scenario_yaml.encode()
            self._attach("scenario.yaml", "application/yaml", text)
        self._attach("calibration.json", "application/json", attachments.dump_told(dataset))
        self._write("/tf_static", ns, m.transforms(ns, *self._static_frames()))
        if truth is not None:
            self._attach("truth.npz", "application/zip", attachments.dump_truth(dataset, truth))
            poses = map(m.pose, truth.T_world_imu)
            self._true_path = list(map(m.pose_stamped, self._stamps_ns, poses))
            ids = np.arange(len(truth.landmarks))
            self._write("/ground_truth/path", ns, m.path(ns, self._true_path))
            self._write("/ground_truth/landmarks", ns, m.cloud(ns, truth.landmarks, ids))
        self._writer.flush()

    def _static_frames(self) -> list[m.Frame]:
        here, calibration = m.pose(np.eye(4)), self._dataset.calibration
        frames = [m.Frame("map", "odom", here), m.Frame("base_link", "imu", here)]
        if self._filter is None and self._dataset.truth is not None:
            frames.append(m.Frame("base_link_gt", "base_link", here))
        frames.append(m.Frame("imu", "cam0", m.pose(calibration.T_imu_cam)))
        if isinstance(calibration.rig, StereoRig):
            T_cam0_cam1 = np.eye(4)
            T_cam0_cam1[0, 3] = calibration.rig.baseline_m
            frames.append(m.Frame("cam0", "cam1", m.pose(T_cam0_cam1)))
        return frames

    def _write_imu(self, until: int) -> None:
        imu = self._dataset.imu
        if imu is not None:
            for i in range(self._imu_written, until):
                ns = self._imu_ns[i]
                self._write("/imu0", ns, m.imu(ns, imu.gyro[i], imu.accel[i]))
            self._imu_written = until

    def _write_readings(self, ns: int, frame: int) -> None:
        dataset, noise = self._dataset, self._dataset.noise
        for topic, camera in self._cameras.items():
            camera.header.stamp = m.stamp(ns)
            self._write(topic, ns, camera)
        features = dataset.frame(frame) if dataset.sightings is not None else None
        if isinstance(features, StereoFrame):
            self._write("/stereo/features", ns, m.features(ns, features, noise.sigma_px))
        if isinstance(features, PointFrame):
            self._write("/point/features", ns, m.points(ns, features))
        # The other noise models are no covariance of this sample.
        covariance = noise.process if noise.process_model == "twist" else m.UNKNOWN_COVARIANCE
        velocity = m.twist(dataset.linear_velocity[frame], dataset.angular_velocity[frame])
        self._write("/twist", ns, m.twist_stamped(ns, velocity, covariance))

    def _write_pictures(self, ns: int, frame: StereoFrame, innovation: Innovation | None) -> None:
        fate = pictures.fates(frame, innovation)
        for i in (0, 1):
            png = pictures.draw(frame.pixels[:, 2 * i : 2 * i + 2], fate, self._size_px)
            self._write(f"/cam{i}/image/compressed", ns, m.compressed_image(ns, f"cam{i}", png))

    def _write_truth(self, ns: int, frame: int, truth: Truth) -> None:
        stamped = self._true_path[frame]
        velocity = m.twist(truth.linear_velocity[frame], truth.angular_velocity[frame])
        odometry = m.odometry(ns, "base_link_gt", stamped.pose, m.UNKNOWN_COVARIANCE, velocity)
        self._write("/tf", ns, m.transforms(ns, m.Frame("map", "base_link_gt", stamped.pose)))
        self._write("/ground_truth/odometry", ns, odometry)
        self._write("/ground_truth/pose", ns, stamped)

    def _write_estimate(self, ns: int, step: Step) -> None:
        stamped = self._write_poses("/estimate", ns, ns, step.frame, step.belief)
        at = stamped.pose
        self._write("/tf", ns, m.transforms(ns, m.Frame("odom", "base_link", at)))
        self._estimated_path.append(stamped)
        if step.frame in self._slow_frames:
            self._write("/estimate/path", ns, m.path(ns, self._estimated_path))
            self._write_map(ns, step.belief)

    def _write_smoothed(self, log_ns: int, beliefs: tuple[Belief, ...]) -> None:
        """Stamped with the time of their frames, logged when they became known."""
        path = [
            self._write_poses("/smoothed", log_ns, self._stamps_ns[frame], frame, belief)
            for frame, belief in enumerate(beliefs)
        ]
        self._write("/smoothed/path", log_ns, m.path(log_ns, path))

    def _write_poses(
        self, prefix: str, log_ns: int, ns: int, frame: int, belief: Belief
    ) -> m.Message:
        """Write the odometry and the pose of a belief; the pose without covariance."""
        dataset, at = self._dataset, m.pose(belief.T_world_imu)
        covariance = covariance_about_map_axes(belief)
        velocity = m.twist(dataset.linear_velocity[frame], dataset.angular_velocity[frame])
        odometry = m.odometry(ns, "base_link", at, covariance, velocity)
        self._write(f"{prefix}/odometry", log_ns, odometry)
        self._write(f"{prefix}/pose", log_ns, m.pose_with_covariance_stamped(ns, at, covariance))
        return m.pose_stamped(ns, at)

    def _write_map(self, ns: int, belief: Belief) -> None:
        ids, points, covariances = belief.ids, belief.landmarks, belief.landmark_covariances
        if not len(ids) and "/estimate/landmarks" not in self._channels:
            return  # a filter without a map
        if len(covariances) != len(ids):  # the filter gives none
            covariances = np.full((len(ids), 3, 3), np.nan)
        variance = np.trace(covariances, axis1=-2, axis2=-1) / 3
        sigma = np.sqrt(np.maximum(variance, 0))
        sure = np.isfinite(covariances).all(axis=(-2, -1))
        markers = m.ellipsoids(ns, points[sure], ids[sure], covariances[sure])
        self._write("/estimate/landmarks", ns, m.cloud(ns, points, ids, sigma=sigma))
        self._write("/estimate/landmark_markers", ns, markers)

    def _write_consistency(self, ns: int, step: Step) -> None:
        belief, innovation, truth = step.belief, step.innovation, self._dataset.truth
        P = belief.pose_covariance
        if truth is not None and P is not None and P.any():
            value = float(nees(belief.pose_error(truth.T_world_imu[step.frame]), P))
            message = m.consistency(ns, "pose NEES", value, 6, _band(6))
            self._write("/consistency/nees", ns, message)
        if innovation is not None and (dof := int(innovation.dof)):
            message = m.consistency(ns, "NIS", float(innovation.nis), dof, _band(dof))
            self._write("/consistency/nis", ns, message)

    def _write(self, topic: str, ns: int, message: m.Message) -> None:
        if topic not in self._channels:
            self._channels[topic] = self._channel(topic, message.__msgtype__)
        self._writer.add_message(self._channels[topic], ns, m.to_cdr(message), ns)

    def _channel(self, topic: str, type_name: str) -> Any:
        if type_name not in self._schemas:  # the writer does not see that two are the same
            self._schemas[type_name] = self._writer.register_schema(
                type_name, "ros2msg", m.schema_text(type_name)
            )
        profiles = {"offered_qos_profiles": m.qos(latched=topic in LATCHED)}
        return self._writer.register_channel(topic, "cdr", self._schemas[type_name], profiles)

    def _attach(self, name: str, media_type: str, data: bytes) -> None:
        self._writer.add_attachment(0, self._start_ns, name, media_type, data)

    def _write_metadata(self, *, finished: bool) -> None:
        self._writer.add_metadata("simbench", self._made_by | {"finished": str(finished).lower()})


@cache
def _band(dof: int) -> tuple[float, float]:
    """Where 95 % of a chi-square with `dof` degrees lies, with equal tails."""
    lower, upper = chi_square_band(dof, 0.95)
    return float(lower), float(upper)


def _path_spacing_ns(stamps_ns: list[int]) -> int:
    """A second; a hundredth of a long run.

    Each path holds all poses up to its own, so that one a second would grow with the square of the
    run's length.
    """
    return max(SECOND_NS, (stamps_ns[-1] - stamps_ns[0]) // 100)
