"""Every message of every topic, read by rosbags with the types in the file, against the record."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from evo.tools import file_interface
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore
from scipy import stats
from scipy.spatial.transform import Rotation

from simbench.mcap import messages as written
from simbench.mcap.axes import covariance_about_map_axes
from tests.simbench.recordings import (
    EPOCH_NS,
    FRAMES,
    LANDMARKS,
    Truthful,
    drive,
    messages,
    record_drive,
)
from vislam.charts import LEFT
from vislam.lie import so3
from vislam.types import Belief

TYPES = {
    "/tf": "tf2_msgs/msg/TFMessage",
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/imu0": "sensor_msgs/msg/Imu",
    "/twist": "geometry_msgs/msg/TwistWithCovarianceStamped",
    "/cam0/camera_info": "sensor_msgs/msg/CameraInfo",
    "/cam1/camera_info": "sensor_msgs/msg/CameraInfo",
    "/cam0/image/compressed": "sensor_msgs/msg/CompressedImage",
    "/cam1/image/compressed": "sensor_msgs/msg/CompressedImage",
    "/stereo/features": "simbench_msgs/msg/StereoFeatures",
    "/ground_truth/odometry": "nav_msgs/msg/Odometry",
    "/ground_truth/pose": "geometry_msgs/msg/PoseStamped",
    "/ground_truth/path": "nav_msgs/msg/Path",
    "/ground_truth/landmarks": "sensor_msgs/msg/PointCloud2",
    "/estimate/odometry": "nav_msgs/msg/Odometry",
    "/estimate/pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "/estimate/path": "nav_msgs/msg/Path",
    "/estimate/landmarks": "sensor_msgs/msg/PointCloud2",
    "/estimate/landmark_markers": "visualization_msgs/msg/MarkerArray",
    "/smoothed/odometry": "nav_msgs/msg/Odometry",
    "/smoothed/pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "/smoothed/path": "nav_msgs/msg/Path",
    "/consistency/nees": "simbench_msgs/msg/Consistency",
    "/consistency/nis": "simbench_msgs/msg/Consistency",
}
FRAME_TOPICS = [
    topic
    for topic in TYPES
    if topic.startswith(("/twist", "/cam", "/stereo"))
    or (topic.endswith(("odometry", "/pose", "/nees")) and not topic.startswith("/smoothed"))
]
LATCHED = {"/tf_static", "/ground_truth/path", "/ground_truth/landmarks", "/smoothed/path"}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    path = tmp_path_factory.mktemp("mcap") / "drive.truthful.mcap"
    dataset = drive()
    record = record_drive(path, dataset)
    return SimpleNamespace(path=path, dataset=dataset, record=record, topics=messages(path))


def stamp_ns(header):
    return header.stamp.sec * 10**9 + header.stamp.nanosec


def matrix(pose):
    """A motion from a Pose or a Transform."""
    p = getattr(pose, "position", None) or pose.translation
    q = getattr(pose, "orientation", None) or pose.rotation
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
    T[:3, 3] = p.x, p.y, p.z
    return T


def xyz(v):
    return [v.x, v.y, v.z]


def points(cloud):
    """The rows of a cloud, read as its fields say."""
    formats = {7: "<f4", 6: "<u4"}
    dtype = np.dtype(
        {
            "names": [f.name for f in cloud.fields],
            "formats": [formats[f.datatype] for f in cloud.fields],
            "offsets": [f.offset for f in cloud.fields],
            "itemsize": cloud.point_step,
        }
    )
    assert cloud.height * cloud.width * cloud.point_step == cloud.row_step == len(cloud.data)
    return np.frombuffer(cloud.data.tobytes(), dtype)


def close(actual, expected):
    np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-12)


def test_every_topic_is_there_with_its_type_as_cdr_of_profile_ros2(made):
    with made.path.open("rb") as stream:
        reader = make_reader(stream)
        contents = reader.get_summary()
        header = reader.get_header()
    schemas = {c.topic: contents.schemas[c.schema_id] for c in contents.channels.values()}
    assert {topic: schema.name for topic, schema in schemas.items()} == TYPES
    assert len(contents.channels) == len(TYPES)
    assert {schema.encoding for schema in schemas.values()} == {"ros2msg"}
    assert {c.message_encoding for c in contents.channels.values()} == {"cdr"}
    assert len(contents.schemas) == len(set(TYPES.values()))
    assert header.profile == "ros2"
    assert header.library.startswith("simbench ")


def test_what_is_written_once_is_transient_local(made):
    with Reader(made.path) as reader:
        profiles = {c.topic: c.ext.offered_qos_profiles for c in reader.connections}
    latched = {t for t, (p,) in profiles.items() if p.durability.name == "TRANSIENT_LOCAL"}
    assert latched == LATCHED
    assert {p.durability.name for t, (p,) in profiles.items() if t not in LATCHED} == {"VOLATILE"}
    assert {p.reliability.name for (p,) in profiles.values()} == {"RELIABLE"}
    assert {len(made.topics[topic]) for topic in LATCHED} == {1}


def test_messages_stand_in_log_time_order_and_are_stamped_with_it(made):
    with made.path.open("rb") as stream:
        logged = [m for _, _, m in make_reader(stream).iter_messages(log_time_order=False)]
    times = [message.log_time for message in logged]
    assert times == sorted(times)
    assert all(message.publish_time == message.log_time for message in logged)
    for topic, received in made.topics.items():
        for log_ns, message in received if not topic.startswith("/smoothed") else ():
            for header in headers(message):
                assert stamp_ns(header) == log_ns


def headers(message):
    if hasattr(message, "header"):
        return [message.header]
    return [part.header for part in getattr(message, "transforms", None) or message.markers]


def test_each_frame_has_its_messages_at_its_time(made):
    expected = (EPOCH_NS + made.dataset.times_ns).tolist()
    for topic in FRAME_TOPICS:
        assert [log_ns for log_ns, _ in made.topics[topic]] == expected, topic
    assert [ns for ns, _ in made.topics["/tf"]] == sorted(expected * 2)


def test_twist_is_the_filters_input_to_the_last_bit(made):
    received = [m for _, m in made.topics["/twist"]]
    twists = [m.twist.twist for m in received]
    np.testing.assert_array_equal([xyz(t.linear) for t in twists], made.dataset.linear_velocity)
    np.testing.assert_array_equal([xyz(t.angular) for t in twists], made.dataset.angular_velocity)
    for m in received:
        np.testing.assert_array_equal(m.twist.covariance, made.dataset.noise.process.ravel())
        assert m.header.frame_id == "imu"


def test_covariance_of_the_twist_is_unknown_where_the_noise_model_is_another(tmp_path):
    dataset = drive(2)
    noise = replace(dataset.noise, process_model="additive")
    record_drive(tmp_path / "a.mcap", replace(dataset, noise=noise))
    (_, first), *_ = messages(tmp_path / "a.mcap")["/twist"]
    assert not first.twist.covariance.any()


def test_features_are_the_frames_to_the_last_bit_with_nan_for_what_is_not_seen(made):
    seen_nan = 0
    for i, (_, m) in enumerate(made.topics["/stereo/features"]):
        frame = made.dataset.frame(i)
        np.testing.assert_array_equal(m.track_id, frame.ids)
        pixels = np.stack([m.u0, m.v0, m.u1, m.v1], axis=-1).reshape(-1, 4)
        np.testing.assert_array_equal(np.isnan(pixels), frame.pixels == -1)
        np.testing.assert_array_equal(np.nan_to_num(pixels, nan=-1), frame.pixels)
        np.testing.assert_array_equal(m.flags, frame.last.astype(int) * m.LAST)
        np.testing.assert_array_equal(m.sigma_px, made.dataset.noise.sigma_px)
        seen_nan += np.isnan(pixels).sum()
    assert seen_nan == 4 * (FRAMES - 1)


def test_imu_readings_are_raw_and_say_that_they_have_no_orientation(made):
    imu = made.dataset.imu
    received = made.topics["/imu0"]
    assert [ns for ns, _ in received] == (EPOCH_NS + imu.times_ns).tolist()
    np.testing.assert_array_equal([xyz(m.angular_velocity) for _, m in received], imu.gyro)
    np.testing.assert_array_equal([xyz(m.linear_acceleration) for _, m in received], imu.accel)
    assert {m.orientation_covariance[0] for _, m in received} == {-1.0}


def test_camera_infos_project_a_point_as_the_rig_does(made):
    rig = made.dataset.calibration.rig
    q = np.array([0.4, -0.3, 5.0, 1.0])
    expected = {
        "cam0": [rig.fx_px * 0.08 + rig.cx_px, rig.fy_px * -0.06 + rig.cy_px],
        "cam1": [rig.fx_px * (0.4 - 0.6) / 5 + rig.cx_px, rig.fy_px * -0.06 + rig.cy_px],
    }
    for name, pixel in expected.items():
        for _, m in made.topics[f"/{name}/camera_info"]:
            u, v, w = m.p.reshape(3, 4) @ q
            np.testing.assert_allclose([u / w, v / w], pixel, rtol=1e-14)
            np.testing.assert_array_equal(m.k.reshape(3, 3), rig.K)
            np.testing.assert_array_equal(m.r.reshape(3, 3), np.eye(3))
            assert (m.width, m.height) == rig.image_px
            assert not m.d.any()
            assert m.header.frame_id == name


def test_transform_tree_has_one_root_and_leads_to_the_cameras_and_the_truth(made):
    dataset = made.dataset
    static = {t.child_frame_id: t for t in made.topics["/tf_static"][0][1].transforms}
    moving = [m.transforms for _, m in made.topics["/tf"]]
    assert {t.child_frame_id for ts in moving for t in ts}.isdisjoint(static)
    for i in range(FRAMES):
        tree = dict(static)
        for transforms in moving[2 * i : 2 * i + 2]:
            tree |= {t.child_frame_id: t for t in transforms}
        assert set(tree) == {"odom", "base_link", "imu", "cam0", "cam1", "base_link_gt"}

        def in_map(frame, tree=tree):
            if frame == "map":
                return np.eye(4)
            return in_map(tree[frame].header.frame_id) @ matrix(tree[frame].transform)

        T_world_imu = made.record.T_world_imu[i]
        T_world_cam0 = T_world_imu @ dataset.calibration.T_imu_cam
        right_eye = T_world_cam0 @ [dataset.calibration.rig.baseline_m, 0, 0, 1]
        close(in_map("imu"), T_world_imu)
        close(in_map("cam0"), T_world_cam0)
        close(in_map("cam1")[:, 3], right_eye)
        close(in_map("base_link_gt"), dataset.truth.T_world_imu[i])


def test_ground_truth_is_the_truth(made):
    truth = made.dataset.truth
    odometry = [m for _, m in made.topics["/ground_truth/odometry"]]
    close([matrix(m.pose.pose) for m in odometry], truth.T_world_imu)
    close([matrix(m.pose) for _, m in made.topics["/ground_truth/pose"]], truth.T_world_imu)
    ((_, path),) = made.topics["/ground_truth/path"]
    close([matrix(p.pose) for p in path.poses], truth.T_world_imu)
    expected = (EPOCH_NS + made.dataset.times_ns).tolist()
    assert [stamp_ns(p.header) for p in path.poses] == expected
    np.testing.assert_array_equal(
        [xyz(m.twist.twist.linear) for m in odometry], truth.linear_velocity
    )
    np.testing.assert_array_equal(
        [xyz(m.twist.twist.angular) for m in odometry], truth.angular_velocity
    )
    assert {(m.header.frame_id, m.child_frame_id) for m in odometry} == {("map", "base_link_gt")}
    ((_, cloud),) = made.topics["/ground_truth/landmarks"]
    rows = points(cloud)
    np.testing.assert_array_equal(rows["id"], np.arange(LANDMARKS))
    stacked = np.stack([rows["x"], rows["y"], rows["z"]], axis=-1)
    np.testing.assert_array_equal(stacked, truth.landmarks.astype(np.float32))


def test_estimates_are_the_records_with_covariance_about_the_axes_of_the_map(made):
    odometry = [m for _, m in made.topics["/estimate/odometry"]]
    poses = [m for _, m in made.topics["/estimate/pose"]]
    for step, o, p in zip(made.record.steps, odometry, poses, strict=True):
        close(matrix(o.pose.pose), step.belief.T_world_imu)
        close(matrix(p.pose.pose), step.belief.T_world_imu)
        R = step.belief.T_world_imu[:3, :3]
        blocks = step.belief.pose_covariance.reshape(2, 3, 2, 3)
        expected = np.einsum("ij,ajbk,lk->aibl", R, blocks, R).ravel()
        close(o.pose.covariance, expected)
        close(p.pose.covariance, expected)
        assert (o.header.frame_id, o.child_frame_id) == ("map", "base_link")
    velocity = made.dataset.linear_velocity
    np.testing.assert_array_equal([xyz(m.twist.twist.linear) for m in odometry], velocity)


@pytest.mark.parametrize("chart", ["left", LEFT.error], ids=["by name", "as a function"])
def test_covariance_in_another_chart_is_carried_to_the_axes_of_the_map(chart):
    # T_true = exp(xi^) T moves the position by rho + phi x p and turns about the map's axes by phi.
    belief = Truthful(drive(1))
    belief.update(drive(1).frame(0))
    T, P = belief.belief().T_world_imu, belief.belief().pose_covariance
    to_map = np.eye(6)
    to_map[:3, 3:] = -so3.hat(T[:3, 3])
    left = Belief(T_world_imu=T, pose_covariance=P, chart=chart)
    np.testing.assert_allclose(covariance_about_map_axes(left), to_map @ P @ to_map.T, atol=1e-9)


def test_estimated_path_comes_at_most_once_a_second_and_is_whole_at_the_end(made):
    received = made.topics["/estimate/path"]
    assert (np.diff([ns for ns, _ in received]) >= 10**9).all()
    assert len(received) == 4
    for log_ns, path in received:
        stamps = [stamp_ns(p.header) for p in path.poses]
        assert stamps == [t for t in (EPOCH_NS + made.dataset.times_ns).tolist() if t <= log_ns]
        close([matrix(p.pose) for p in path.poses], made.record.T_world_imu[: len(stamps)])
    assert len(received[-1][1].poses) == FRAMES


def test_a_long_run_has_about_a_hundred_paths(tmp_path):
    dataset = drive(300)
    slow = replace(dataset, times_s=np.arange(300.0), imu=None, sightings=None)
    record_drive(tmp_path / "long.mcap", slow)
    received = messages(tmp_path / "long.mcap")["/estimate/path"]
    assert len(received) == 100  # every third frame
    assert len(received[-1][1].poses) == 300


def test_smoothed_poses_have_the_time_of_their_frame_and_are_logged_at_the_end(made):
    stamps = (EPOCH_NS + made.dataset.times_ns).tolist()
    odometry, poses = made.topics["/smoothed/odometry"], made.topics["/smoothed/pose"]
    assert {ns for ns, _ in odometry + poses} == {stamps[-1]}
    for received in (odometry, poses):
        assert [stamp_ns(m.header) for _, m in received] == stamps
    for belief, (_, o), (_, p) in zip(made.record.smoothed, odometry, poses, strict=True):
        close(matrix(o.pose.pose), belief.T_world_imu)
        close(matrix(p.pose.pose), belief.T_world_imu)
        close(o.pose.covariance, covariance_about_map_axes(belief).ravel())
        close(p.pose.covariance, o.pose.covariance)
    ((log_ns, path),) = made.topics["/smoothed/path"]
    assert log_ns == stamps[-1]
    assert [stamp_ns(p.header) for p in path.poses] == stamps
    close([matrix(p.pose) for p in path.poses], [b.T_world_imu for b in made.record.smoothed])


def beliefs_of_the_map(made):
    """The beliefs that the map topics show, in order: the living ones, then the final map."""
    stamps = (EPOCH_NS + made.dataset.times_ns).tolist()
    times = [ns for ns, _ in made.topics["/estimate/landmarks"]]
    assert (np.diff(times[:-1]) >= 10**9).all()
    assert times[-2:] == [stamps[-1]] * 2
    steps = [made.record.steps[stamps.index(ns)].belief for ns in times[:-1]]
    return [*steps, made.record.final]


def test_cloud_holds_the_living_landmarks_and_at_the_end_all(made):
    beliefs = beliefs_of_the_map(made)
    assert len(beliefs) == 5
    for belief, (_, cloud) in zip(beliefs, made.topics["/estimate/landmarks"], strict=True):
        rows = points(cloud)
        assert [f.name for f in cloud.fields] == ["x", "y", "z", "id", "sigma"]
        np.testing.assert_array_equal(rows["id"], belief.ids)
        stacked = np.stack([rows["x"], rows["y"], rows["z"]], axis=-1)
        np.testing.assert_array_equal(stacked, belief.landmarks.astype(np.float32))
        mean_variance = [np.linalg.eigvalsh(P).mean() for P in belief.landmark_covariances]
        np.testing.assert_allclose(rows["sigma"], np.sqrt(mean_variance), rtol=1e-6)
    assert len(beliefs[-1].ids) == LANDMARKS > len(beliefs[-2].ids)


def test_markers_are_ellipsoids_of_three_sigma_after_an_order_to_delete_all(made):
    for belief, (_, array) in zip(
        beliefs_of_the_map(made), made.topics["/estimate/landmark_markers"], strict=True
    ):
        delete, *spheres = array.markers
        assert (delete.action, delete.ns) == (delete.DELETEALL, "")
        assert {(s.action, s.type) for s in spheres} == {(delete.ADD, delete.SPHERE)}
        assert [s.id for s in spheres] == belief.ids.tolist()
        for i, s in enumerate(spheres):
            T, radius = matrix(s.pose), np.array(xyz(s.scale)) / 2
            covariance = T[:3, :3] @ np.diag((radius / 3) ** 2) @ T[:3, :3].T
            np.testing.assert_allclose(covariance, belief.landmark_covariances[i], atol=1e-5)
            close(T[:3, 3], belief.landmarks[i])


def test_consistency_holds_nees_and_nis_with_their_bands(made):
    nees, nis = made.topics["/consistency/nees"], made.topics["/consistency/nis"]
    inside = set()
    for step, (_, m) in zip(made.record.steps, nees, strict=True):
        e = step.belief.pose_error(made.dataset.truth.T_world_imu[step.frame])
        np.testing.assert_allclose(
            m.value, e @ np.linalg.inv(step.belief.pose_covariance) @ e, rtol=1e-6
        )
        assert m.dof == 6
        np.testing.assert_allclose([m.lower, m.upper], stats.chi2.interval(0.95, 6), rtol=1e-9)
        assert m.inside == (m.lower <= m.value <= m.upper)
        inside.add(m.inside)
    assert inside == {True, False}
    assert {m.name for _, m in nees} == {"pose NEES"}
    measured = [s.innovation for s in made.record.steps if s.innovation.dof]
    assert len(measured) == FRAMES - 1
    for innovation, (_, m) in zip(measured, nis, strict=True):
        assert (m.name, m.value, m.dof) == ("NIS", innovation.nis, innovation.dof)
        np.testing.assert_allclose(
            [m.lower, m.upper], stats.chi2.interval(0.95, int(innovation.dof)), rtol=1e-9
        )


class PoseOnly(Truthful):
    """No innovation, no covariance, no map."""

    def update(self, frame):
        super().update(frame)

    def belief(self, joint=False):  # noqa: ARG002
        return Belief(T_world_imu=super().belief().T_world_imu)

    def finish(self):
        return self.belief()


class ExactStart(Truthful):
    """A pose that is known at first, and a map without covariances."""

    def belief(self, joint=False):  # noqa: ARG002
        belief = replace(super().belief(), landmark_covariances=np.empty((0, 3, 3)))
        return belief if self.frame else replace(belief, pose_covariance=np.zeros((6, 6)))


def test_what_a_filter_does_not_estimate_is_absent(tmp_path):
    record_drive(tmp_path / "p.mcap", drive(), PoseOnly)
    topics = messages(tmp_path / "p.mcap")
    missing = {
        t for t in TYPES if t.startswith(("/consistency", "/smoothed")) or "estimate/landmark" in t
    }
    assert set(topics) == set(TYPES) - missing
    assert not any(m.pose.covariance.any() for _, m in topics["/estimate/pose"])


def test_a_known_start_has_no_nees_and_a_map_without_covariances_no_ellipsoids(tmp_path):
    record_drive(tmp_path / "e.mcap", drive(11), ExactStart)
    topics = messages(tmp_path / "e.mcap")
    assert len(topics["/consistency/nees"]) == 10
    clouds, arrays = topics["/estimate/landmarks"], topics["/estimate/landmark_markers"]
    for (_, cloud), (_, array) in zip(clouds[:-1], arrays[:-1], strict=True):
        assert len(points(cloud))
        assert np.isnan(points(cloud)["sigma"]).all()
        assert len(array.markers) == 1  # what takes the former ones away


def test_evo_reads_the_estimate(made):
    with Reader(made.path) as reader:
        for topic in ("/estimate/pose", "/estimate/odometry"):
            trajectory = file_interface.read_bag_trajectory(reader, topic)
            close(trajectory.poses_se3, made.record.T_world_imu)
            np.testing.assert_allclose(
                trajectory.timestamps - EPOCH_NS / 1e9, made.dataset.times_s, atol=1e-6
            )


def test_types_are_the_same_on_the_wire_from_humble_to_the_newest_release():
    releases = [s for s in Stores if s.name in {"ROS2_HUMBLE", "ROS2_JAZZY", "LATEST"}]
    assert len(releases) == 3
    standard = {name for name in TYPES.values() if not name.startswith("simbench")}
    for store in map(get_typestore, releases):
        for name in standard:
            assert store.hash_rihs01(name) == written.STORE.hash_rihs01(name)
