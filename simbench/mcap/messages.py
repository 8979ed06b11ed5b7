"""ROS 2 messages from arrays, and their bytes.

Types, schema text and CDR come from rosbags' store of ROS 2 Humble. On the wire the types used here
are the same from Humble to the newest release; before it a Marker had fewer fields, after it only
constants came in. So a reader of any of these releases reads them, with its own types too.
"""

from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import yaml
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from vislam.arrays import Array, BoolArray, IntArray
from vislam.camera import StereoRig
from vislam.types import PointFrame, StereoFrame

#: Our own types, a ROS package to build beside these files.
INTERFACES = Path(__file__).with_name("simbench_msgs")
DEFINITIONS = {
    f"simbench_msgs/msg/{path.stem}": path.read_text(encoding="utf-8")
    for path in sorted(INTERFACES.glob("msg/*.msg"))
}

#: A message; its class is made by rosbags from the definition.
Message: TypeAlias = Any

STORE = get_typestore(Stores.ROS2_HUMBLE)
for _name, _text in DEFINITIONS.items():
    STORE.register(get_types_from_msg(_text, _name))

UNKNOWN_COVARIANCE = np.zeros((6, 6))  #: what zeros mean to ROS
LAST = 1
#: RViz refuses a marker that is flat.
MIN_MARKER_SIZE_M = 1e-3
#: "For ever", as rosbag2 writes it.
_INFINITE = {"sec": 9223372036, "nsec": 854775807}
_SPHERE, _ADD, _DELETE_ALL = 2, 0, 3
_UINT32, _FLOAT32 = 6, 7


class Frame(NamedTuple):
    """A frame of the transform tree, and its pose in its parent."""

    parent: str
    child: str
    pose: Message


def qos(latched: bool) -> str:
    """The text of ``offered_qos_profiles``; a late subscriber still gets a latched topic.

    Policies are numbers, as rosbag2 wrote them up to Iron: older readers know no other form, and
    newer ones read both.
    """
    profile = {
        "history": 1,  # keep last
        "depth": 1 if latched else 10,
        "reliability": 1,  # reliable
        "durability": 1 if latched else 2,  # transient local, volatile
        "deadline": dict(_INFINITE),
        "lifespan": dict(_INFINITE),
        "liveliness": 1,  # automatic
        "liveliness_lease_duration": dict(_INFINITE),
        "avoid_ros_namespace_conventions": False,
    }
    return str(yaml.safe_dump([profile], sort_keys=False))


def schema_text(type_name: str) -> bytes:
    """The definition of a type and of all that it is made of."""
    return STORE.generate_msgdef(type_name, ros_version=2)[0].encode()


def to_cdr(message: Message) -> bytes:
    """The bytes of a message."""
    return bytes(STORE.serialize_cdr(message, message.__msgtype__, little_endian=True))


def from_cdr(data: bytes, type_name: str) -> Message:
    """The message of some bytes."""
    return STORE.deserialize_cdr(data, type_name)


def make(type_name: str, *fields: Any) -> Message:
    """A message from its fields, in their order; ``pkg/Type`` for ``pkg/msg/Type``."""
    return _class(type_name)(*fields)


@cache
def _class(type_name: str) -> Any:
    return STORE.types[type_name.replace("/", "/msg/")]


def stamp(ns: int) -> Message:
    """A time, from whole nanoseconds."""
    return make("builtin_interfaces/Time", *divmod(ns, 10**9))


def header(ns: int, frame_id: str) -> Message:
    """A header with its time."""
    return make("std_msgs/Header", stamp(ns), frame_id)


def pose(T: Array) -> Message:
    """A pose, from shape (4, 4)."""
    return make("geometry_msgs/Pose", point(T[:3, 3]), quaternion(T[:3, :3]))


def point(p: Array) -> Message:
    """A point, from shape (3,)."""
    return make("geometry_msgs/Point", *p.tolist())


def vector(v: Array) -> Message:
    """A vector, from shape (3,)."""
    return make("geometry_msgs/Vector3", *v.tolist())


def quaternion(R: Array) -> Message:
    """A quaternion, from a rotation of shape (3, 3)."""
    return make("geometry_msgs/Quaternion", *Rotation.from_matrix(R).as_quat().tolist())


_UPRIGHT = quaternion(np.eye(3))


def twist(linear: Array, angular: Array) -> Message:
    """A twist, from two vectors of shape (3,)."""
    return make("geometry_msgs/Twist", vector(linear), vector(angular))


def transforms(ns: int, *frames: Frame) -> Message:
    """A piece of the transform tree."""
    return make("tf2_msgs/TFMessage", [_transform(ns, *frame) for frame in frames])


def _transform(ns: int, parent: str, child: str, at: Message) -> Message:
    p = at.position
    translation = make("geometry_msgs/Vector3", p.x, p.y, p.z)
    value = make("geometry_msgs/Transform", translation, at.orientation)
    return make("geometry_msgs/TransformStamped", header(ns, parent), child, value)


def pose_stamped(ns: int, at: Message) -> Message:
    """A pose in the map."""
    return make("geometry_msgs/PoseStamped", header(ns, "map"), at)


def pose_with_covariance_stamped(ns: int, at: Message, covariance: Array) -> Message:
    """A pose in the map; covariance about the map's axes, translation first, shape (6, 6)."""
    value = make("geometry_msgs/PoseWithCovariance", at, covariance.ravel())
    return make("geometry_msgs/PoseWithCovarianceStamped", header(ns, "map"), value)


def odometry(ns: int, child: str, at: Message, covariance: Array, velocity: Message) -> Message:
    """A pose in the map with its covariance, and a twist in the body."""
    return make(
        "nav_msgs/Odometry",
        header(ns, "map"),
        child,
        make("geometry_msgs/PoseWithCovariance", at, covariance.ravel()),
        make("geometry_msgs/TwistWithCovariance", velocity, UNKNOWN_COVARIANCE.ravel()),
    )


def path(ns: int, poses: list[Message]) -> Message:
    """A path of stamped poses in the map."""
    return make("nav_msgs/Path", header(ns, "map"), poses)


def twist_stamped(ns: int, velocity: Message, covariance: Array) -> Message:
    """A twist of the body with its covariance, linear first, shape (6, 6)."""
    value = make("geometry_msgs/TwistWithCovariance", velocity, covariance.ravel())
    return make("geometry_msgs/TwistWithCovarianceStamped", header(ns, "imu"), value)


def imu(ns: int, gyro: Array, accel: Array) -> Message:
    """A raw inertial reading, shape (3,) each; -1 says that there is no orientation."""
    unknown = np.zeros(9)
    return make(
        "sensor_msgs/Imu",
        *(header(ns, "imu"), _UPRIGHT, np.concatenate([[-1.0], unknown[1:]])),
        *(vector(gyro), unknown, vector(accel), unknown),
    )


def camera_info(ns: int, rig: StereoRig, size_px: tuple[int, int], *, right: bool) -> Message:
    """The intrinsics of the left or the right camera; width and height are zero where unknown."""
    width, height = size_px
    translation = [[-rig.fx_px * rig.baseline_m if right else 0.0], [0.0], [0.0]]
    return make(
        "sensor_msgs/CameraInfo",
        header(ns, "cam1" if right else "cam0"),
        *(height, width, "plumb_bob", np.zeros(5)),
        *(rig.K.ravel(), np.eye(3).ravel(), np.hstack([rig.K, translation]).ravel()),
        *(0, 0, make("sensor_msgs/RegionOfInterest", 0, 0, 0, 0, False)),
    )


def features(ns: int, frame: StereoFrame, sigma_px: Array) -> Message:
    """The features of a frame; NaN for the coordinates that are -1, "not seen"."""
    columns = np.where(frame.pixels == -1, np.nan, frame.pixels).T
    return make(
        "simbench_msgs/StereoFeatures",
        header(ns, "cam0"),
        frame.ids.astype(np.uint32),
        *np.ascontiguousarray(columns, float),
        np.asarray(sigma_px, float),
        np.where(frame.last, LAST, 0).astype(np.uint8),
    )


def compressed_image(ns: int, frame_id: str, png: bytes) -> Message:
    """A picture of a camera."""
    data = np.frombuffer(png, np.uint8)
    return make("sensor_msgs/CompressedImage", header(ns, frame_id), "png", data)


def of_features(message: Message) -> tuple[IntArray, Array, BoolArray]:
    """What `features` was made of: ids (n,), pixels (n, 4), last (n,)."""
    pixels = np.stack([message.u0, message.v0, message.u1, message.v1], axis=-1)
    last = (message.flags & LAST).astype(bool)
    return message.track_id.astype(np.int64), np.where(np.isnan(pixels), -1.0, pixels), last


def points(ns: int, frame: PointFrame) -> Message:
    """The readings of a point sensor in a frame; NaN, "not seen", stays."""
    return make(
        "simbench_msgs/PointFeatures",
        header(ns, "cam0"),
        frame.ids.astype(np.uint32),
        *np.ascontiguousarray(frame.points.T, float),
        np.where(frame.last, LAST, 0).astype(np.uint8),
    )


def of_points(message: Message) -> tuple[IntArray, Array, BoolArray]:
    """What `points` was made of: ids (n,), points (n, 3), last (n,)."""
    found = np.stack([message.x, message.y, message.z], axis=-1)
    return message.track_id.astype(np.int64), found, (message.flags & LAST).astype(bool)


def cloud(ns: int, points: Array, ids: IntArray, **more: Array) -> Message:
    """Points in the map: x, y, z (float32, which viewers want first), id (uint32), more (float32).

    Args:
        ns: time.
        points: metres, shape (m, 3).
        ids: shape (m,).
        more: further columns by name, shape (m,).
    """
    names = ["x", "y", "z", "id", *more]
    rows = np.empty(len(ids), [(name, "<u4" if name == "id" else "<f4") for name in names])
    for name, column in zip(names, [*points.T, ids, *more.values()], strict=True):
        rows[name] = column
    fields = [
        make("sensor_msgs/PointField", name, 4 * i, _UINT32 if name == "id" else _FLOAT32, 1)
        for i, name in enumerate(names)
    ]
    step = 4 * len(names)
    return make(
        "sensor_msgs/PointCloud2",
        *(header(ns, "map"), 1, len(ids), fields, False, step, step * len(ids)),
        *(np.frombuffer(rows.tobytes(), np.uint8), True),
    )


def ellipsoids(ns: int, centres: Array, ids: IntArray, covariances: Array) -> Message:
    """Markers: an order to take away all earlier ones, then an ellipsoid of 3 sigma a point.

    Args:
        ns: time.
        centres: metres, in the map, shape (m, 3).
        ids: shape (m,).
        covariances: finite, shape (m, 3, 3).
    """
    variances, axes = np.linalg.eigh(covariances)
    axes[..., 0] *= np.linalg.det(axes)[..., None]  # no reflection
    sizes = np.maximum(2 * 3 * np.sqrt(np.maximum(variances, 0)), MIN_MARKER_SIZE_M)
    color = make("std_msgs/ColorRGBA", 0.9, 0.4, 0.0, 0.35)
    head, none = header(ns, "map"), np.empty(0, np.uint8)
    rest: tuple[Any, ...] = (
        *(color, make("builtin_interfaces/Duration", 0, 0), False, [], [], ""),
        *(make("sensor_msgs/CompressedImage", header(0, ""), "", none), [], "", ""),
        *(make("visualization_msgs/MeshFile", "", none), False),
    )
    delete = (head, "", 0, _SPHERE, _DELETE_ALL, pose(np.eye(4)), vector(np.zeros(3)), *rest)
    markers = [make("visualization_msgs/Marker", *delete)]
    if len(ids):
        rotations = Rotation.from_matrix(axes).as_quat()
        for i, p, q, size in zip(ids.tolist(), centres, rotations, sizes, strict=True):
            at = make("geometry_msgs/Pose", point(p), make("geometry_msgs/Quaternion", *q.tolist()))
            add = (head, "landmarks", i, _SPHERE, _ADD, at, vector(size), *rest)
            markers.append(make("visualization_msgs/Marker", *add))
    return make("visualization_msgs/MarkerArray", markers)


def consistency(ns: int, name: str, value: float, dof: int, band: tuple[float, float]) -> Message:
    """A statistic and the band that it should lie in."""
    lower, upper = band
    inside = lower <= value <= upper
    return make(
        "simbench_msgs/Consistency", header(ns, "map"), name, value, dof, lower, upper, inside
    )
