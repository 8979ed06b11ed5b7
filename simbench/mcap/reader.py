"""Reads recordings back, whole or as far as a killed run got."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from mcap.records import Attachment, Channel, McapRecord, Message, Metadata, Schema

from simbench.dataset import Dataset, Origin, PointSightings, RawImu, Sightings, Truth, seconds
from simbench.errors import DatasetError
from simbench.files import file_safe
from simbench.mcap import attachments
from simbench.mcap import messages as m
from simbench.mcap.container import Container
from simbench.mcap.provenance import FORMAT_VERSION
from simbench.mcap.soundness import refuse_unsound
from vislam.arrays import Array, IntArray

#: Topics that have a message for each frame, where they have any.
PER_FRAME = ("/twist", "/stereo/features", "/point/features", "/estimate/odometry")


@dataclass(frozen=True, slots=True, kw_only=True)
class Summary:
    """What is in an MCAP file.

    Attributes:
        types: message type of each topic.
        counts: number of messages of each topic.
        start_s: log time of the first message.
        duration_s: from the first message to the last.
        metadata: the last record ``simbench``; empty where the file is not ours.
        attachments: size of each in bytes.
        finished: whether the file has its end.
    """

    types: dict[str, str]
    counts: dict[str, int]
    start_s: float
    duration_s: float
    metadata: dict[str, str]
    attachments: dict[str, int]
    finished: bool


def summary(path: Path) -> Summary:
    """What is in an MCAP file, ours or not, finished or not.

    Raises:
        DatasetError: it cannot be read, is no MCAP, or is damaged.
    """
    contents = read_contents(path)
    times_ns = [ns for messages in contents.messages.values() for ns, _ in messages] or [0]
    return Summary(
        types=contents.types,
        counts={topic: len(messages) for topic, messages in contents.messages.items()},
        start_s=min(times_ns) / 1e9,
        duration_s=(max(times_ns) - min(times_ns)) / 1e9,
        metadata=contents.metadata.get("simbench", {}),
        attachments={name: len(data) for name, data in contents.attachments.items()},
        finished=contents.finished,
    )


def read_dataset_mcap(path: Path | str) -> Dataset:
    """The dataset of a recording, to the last bit.

    Of an unfinished recording, the frames up to its last simulated second; a note says so.

    Raises:
        DatasetError: it cannot be read, is no MCAP, is none of ours, is damaged, or has no frame.
    """
    return dataset_of(read_contents(Path(path)))


def dataset_of(contents: "Contents") -> Dataset:
    """As `read_dataset_mcap`, of a file that is in memory."""
    path, metadata = contents.path, contents.metadata.get("simbench")
    if metadata is None:
        raise DatasetError(
            f"{path}: expected a recording made by simbench, got an MCAP of other origin with the "
            f"topics {sorted(contents.messages)}."
        )
    if metadata.get("format_version") != str(FORMAT_VERSION):
        raise DatasetError(
            f"{path}: expected format version {FORMAT_VERSION}, got "
            f"{metadata.get('format_version')}, written by simbench {metadata.get('version')}; "
            "read it with that version."
        )
    try:
        dataset = _dataset(contents, metadata)
        refuse_unsound(path, dataset)
        return dataset
    except DatasetError:
        raise
    except Exception as error:  # whatever a damaged message or attachment makes its parser raise
        raise DatasetError(f"{path}: the recording is damaged: {error!r}.") from error


@dataclass(slots=True, kw_only=True)
class Contents:
    """A file in memory: by topic the type and the messages (log time, CDR), the rest by name."""

    path: Path
    types: dict[str, str] = field(default_factory=dict)
    messages: dict[str, list[tuple[int, bytes]]] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    finished: bool = False

    def decoded(self, topic: str) -> list[m.Message]:
        """The messages of a topic."""
        return [m.from_cdr(data, self.types[topic]) for _, data in self.messages.get(topic, ())]

    def times_ns(self, topic: str, epoch_ns: int) -> IntArray:
        """The dataset's times of a topic."""
        return np.array([ns - epoch_ns for ns, _ in self.messages[topic]], np.int64)


def read_contents(path: Path) -> Contents:
    """The whole records of a file, ours or not.

    Raises:
        DatasetError: it cannot be read, is no MCAP, is damaged, or claims more than the limit.
    """
    container = Container(path)
    contents = Contents(path=path, finished=container.finished)
    schemas: dict[int, str] = {}
    topics: dict[int, str] = {}
    for record in container.records():
        _take(record, contents, schemas, topics)
    return contents


def _take(
    record: McapRecord, contents: Contents, schemas: dict[int, str], topics: dict[int, str]
) -> None:
    """Put a record where it belongs."""
    match record:
        case Schema():
            schemas[record.id] = record.name
        case Channel():
            topics[record.id] = record.topic
            contents.types[record.topic] = schemas.get(record.schema_id, "")
            contents.messages.setdefault(record.topic, [])
        case Message():
            if record.channel_id not in topics:
                raise DatasetError(f"{contents.path}: the file is damaged: a message of no topic.")
            message = (record.log_time, record.data)
            contents.messages[topics[record.channel_id]].append(message)
        case Metadata():
            contents.metadata[record.name] = record.metadata
        case Attachment():
            contents.attachments[record.name] = record.data


def _dataset(contents: Contents, metadata: dict[str, str]) -> Dataset:
    told = attachments.load_told(contents.attachments["calibration.json"])
    true_calibration = told.pop("true_calibration")
    epoch_ns = int(metadata["epoch_ns"])
    twists = contents.decoded("/twist")
    features = contents.decoded("/stereo/features") or contents.decoded("/point/features")
    # of its last frame a killed run may have written but a part
    counts = [len(contents.messages[t]) for t in PER_FRAME if contents.messages.get(t)]
    frames = min(counts) if twists else 0
    if not frames:
        raise DatasetError(f"{contents.path}: expected frames, but the recording ends before any.")
    truth, true_biases = None, {}
    if "truth.npz" in contents.attachments:
        arrays = attachments.load_truth(contents.path, contents.attachments["truth.npz"])
        true_biases = {name: arrays.pop(name, None) for name in attachments.TRUTH_OF_IMU}
        landmarks = arrays.pop("landmarks")
        by_frame = {name: array[:frames] for name, array in arrays.items()}
        truth = Truth(landmarks=landmarks, calibration=true_calibration, **by_frame)
    if metadata["finished"] != "true":
        note = f"The recording is unfinished: a run was interrupted after frame {frames - 1}."
        told["notes"] += (note,)
    return Dataset(
        name=file_safe(metadata["scenario"]) or "recording",
        times_s=seconds(contents.times_ns("/twist", epoch_ns)[:frames]),
        linear_velocity=_vectors([t.twist.twist.linear for t in twists[:frames]]),
        angular_velocity=_vectors([t.twist.twist.angular for t in twists[:frames]]),
        sightings=_sightings(features[:frames]) if features else None,
        imu=_imu(contents, epoch_ns, true_biases),
        truth=truth,
        origin=_origin(contents, metadata),
        **told,
    )


def _vectors(messages: list[m.Message]) -> Array:
    return np.array([[v.x, v.y, v.z] for v in messages])


def _sightings(features: list[m.Message]) -> Sightings | PointSightings:
    of_points = "Point" in features[0].__msgtype__
    frames = map(m.of_points if of_points else m.of_features, features)
    ids, readings, last = (list(column) for column in zip(*frames, strict=True))
    start, joined = np.cumsum([0, *map(len, ids)]), np.concatenate(ids)
    z, ends = np.concatenate(readings), np.concatenate(last)
    if of_points:
        return PointSightings(start=start, ids=joined, points=z, last=ends)
    return Sightings(start=start, ids=joined, pixels=z, last=ends)


def _imu(contents: Contents, epoch_ns: int, true_biases: dict[str, Array | None]) -> RawImu | None:
    readings = contents.decoded("/imu0")
    if not readings:
        return None
    known = {k: v[: len(readings)] for k, v in true_biases.items() if v is not None}
    return RawImu(
        times_s=seconds(contents.times_ns("/imu0", epoch_ns)),
        gyro=_vectors([reading.angular_velocity for reading in readings]),
        accel=_vectors([reading.linear_acceleration for reading in readings]),
        **known,
    )


def _origin(contents: Contents, metadata: dict[str, str]) -> Origin | None:
    if not metadata["seed"]:
        return None
    return Origin(
        scenario_yaml=contents.attachments["scenario.yaml"].decode(),
        seed=int(metadata["seed"]),
        run=int(metadata["run"]),
        version=metadata["origin_version"],
    )
