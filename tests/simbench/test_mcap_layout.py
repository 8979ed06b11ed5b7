"""Every panel of the layout against a real run: its topics, their types, its fields and frames."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

import simbench
from simbench.cli import cli
from simbench.mcap import summary
from tests.simbench.recordings import drive, messages, record_drive

LAYOUT = json.loads((Path(simbench.__file__).parent / "mcap/layout.json").read_text())
PANELS = LAYOUT["configById"]

#: What the panels of Lichtblick and Foxglove draw, by their documentation.
IN_3D = {
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "nav_msgs/msg/Path",
    "sensor_msgs/msg/CameraInfo",
    "sensor_msgs/msg/CompressedImage",
    "sensor_msgs/msg/PointCloud2",
    "visualization_msgs/msg/MarkerArray",
}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    path = tmp_path_factory.mktemp("mcap") / "r.mcap"
    record_drive(path, drive())
    return summary(path).types, messages(path)


def of_kind(kind):
    return {name: panel for name, panel in PANELS.items() if name.startswith(f"{kind}!")}


def leaves(node):
    return [node] if isinstance(node, str) else leaves(node["first"]) + leaves(node["second"])


def test_each_panel_has_its_place_and_its_kind_is_one_that_is_checked_here():
    assert sorted(leaves(LAYOUT["layout"])) == sorted(PANELS)
    assert {name.partition("!")[0] for name in PANELS} == {"3D", "Image", "Plot"}


@pytest.mark.parametrize("name", [*of_kind("3D"), *of_kind("Image")])
def test_each_topic_of_a_scene_is_in_the_run_with_a_type_that_is_drawn(run, name):
    types, _ = run
    topics = PANELS[name]["topics"]
    assert topics
    assert all(topic["visible"] for topic in topics.values())
    assert {types[topic] for topic in topics} <= IN_3D


def test_scene_shows_truth_estimate_smoothed_poses_and_ellipsoids(run):
    types, _ = run
    (scene,) = of_kind("3D").values()
    for prefix in ("/ground_truth/", "/estimate/", "/smoothed/"):
        assert f"{prefix}path" in scene["topics"]
    assert "visualization_msgs/msg/MarkerArray" in {types[topic] for topic in scene["topics"]}


def test_each_frame_of_the_scene_is_in_the_transform_tree(run):
    _, topics = run
    known = {"map"}
    for _, message in topics["/tf"] + topics["/tf_static"]:
        known |= {transform.child_frame_id for transform in message.transforms}
    (scene,) = of_kind("3D").values()
    assert scene["followTf"] in known
    assert {name.removeprefix("frame:") for name in scene["transforms"]} <= known
    assert {layer["frameId"] for layer in scene["layers"].values()} <= known


@pytest.mark.parametrize("name", of_kind("Image"))
def test_each_image_has_a_picture_and_the_calibration_of_its_camera(run, name):
    types, topics = run
    mode = PANELS[name]["imageMode"]
    assert types[mode["imageTopic"]] == "sensor_msgs/msg/CompressedImage"
    assert types[mode["calibrationTopic"]] == "sensor_msgs/msg/CameraInfo"
    image, info = (topics[mode[key]][0][1] for key in ("imageTopic", "calibrationTopic"))
    assert image.header.frame_id == info.header.frame_id
    assert image.header.stamp == info.header.stamp
    # The head of a PNG holds its width and height.
    size = image.data[16:24].tobytes()
    assert size == info.width.to_bytes(4, "big") + info.height.to_bytes(4, "big")


def test_both_cameras_are_shown():
    assert {p["imageMode"]["imageTopic"][:5] for p in of_kind("Image").values()} == {
        "/cam0",
        "/cam1",
    }


@pytest.mark.parametrize("name", of_kind("Plot"))
def test_each_line_of_a_plot_is_a_number_of_every_message_of_its_topic(run, name):
    _, topics = run
    paths = PANELS[name]["paths"]
    assert [path["value"].rpartition(".")[2] for path in paths] == ["value", "lower", "upper"]
    for path in paths:
        assert path["enabled"]
        topic, _, fields = path["value"].partition(".")
        assert topics[topic]
        for _, message in topics[topic]:
            value = message
            for field in fields.split("."):
                value = getattr(value, field)
            assert isinstance(value, float)


def test_nees_and_nis_are_plotted():
    plotted = {p["value"].partition(".")[0] for q in of_kind("Plot").values() for p in q["paths"]}
    assert plotted == {"/consistency/nees", "/consistency/nis"}


def test_layout_is_printed_as_it_is():
    done = CliRunner().invoke(cli, ["list", "layout"])
    assert done.exit_code == 0
    assert json.loads(done.output) == LAYOUT
