"""The bag directory as rosbags reads it, and the ROS package of our own messages."""

import re
import xml.etree.ElementTree as ET

import pytest
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader
from rosbags.typesys import get_types_from_msg

from simbench.cli import main
from simbench.convert import convert
from simbench.errors import DatasetError, InputError, OutputError
from simbench.mcap import summary, write_bag_directory
from simbench.mcap.messages import DEFINITIONS, INTERFACES
from tests.simbench.recordings import drive, record_drive


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    path = tmp_path_factory.mktemp("mcap") / "drive.slam.mcap"
    record_drive(path, drive())
    return path


def read(source):
    """What rosbags says of a bag, and every message in it."""
    with Reader(source) as reader:
        topics = {c.topic: (c.msgtype, c.msgcount, c.ext) for c in reader.connections}
        received = [(c.topic, ns, data) for c, ns, data in reader.messages()]
        return topics, received, (reader.start_time, reader.end_time, reader.message_count)


def test_directory_reads_as_the_file_alone(tmp_path, recording):
    write_bag_directory(recording, tmp_path / "bag")
    assert sorted(p.name for p in (tmp_path / "bag").iterdir()) == [recording.name, "metadata.yaml"]
    topics, received, whole = read(tmp_path / "bag")
    alone_topics, alone_received, alone = read(recording)
    assert topics == alone_topics
    assert {topic: count for topic, (_, count, _) in topics.items()} == summary(recording).counts
    assert received == alone_received
    assert whole == alone


def test_directory_is_written_over_and_the_recording_stays(tmp_path, recording):
    before = recording.read_bytes()
    for _ in range(2):
        write_bag_directory(recording, tmp_path / "bag")
    assert (tmp_path / "bag" / recording.name).read_bytes() == before == recording.read_bytes()


@pytest.mark.parametrize(
    ("keep", "message"),
    [(0, "expected a finished MCAP"), (5000, "expected a finished MCAP"), (None, "No such file")],
)
def test_what_is_no_finished_recording_is_one_clear_error(tmp_path, recording, keep, message):
    path = tmp_path / "x.mcap"
    if keep is not None:
        path.write_bytes(recording.read_bytes()[:keep])
    with pytest.raises(DatasetError, match=message):
        write_bag_directory(path, tmp_path / "bag")
    assert not (tmp_path / "bag").exists()


def test_convert_makes_a_bag_directory_of_a_recording_alone(tmp_path, recording):
    assert main(["convert", str(recording), f"{tmp_path / 'bag'}/"]) == 0
    assert read(tmp_path / "bag") == read(recording)
    (tmp_path / "t.tum").write_text("0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n")
    with pytest.raises(InputError, match=r"made of a recording, but .* is a trajectory"):
        convert(tmp_path / "t.tum", tmp_path / "other")


def test_file_in_place_of_the_directory_is_one_clear_error(tmp_path, recording):
    (tmp_path / "bag").write_text("mine")
    with pytest.raises(OutputError, match="Cannot write"):
        write_bag_directory(recording, tmp_path / "bag")
    assert (tmp_path / "bag").read_text() == "mine"


def test_messages_of_the_package_are_those_in_a_recording(recording):
    with recording.open("rb") as stream:
        schemas = make_reader(stream).get_summary().schemas.values()
    embedded = {s.name: s.data.decode() for s in schemas if s.name.startswith("simbench_msgs/")}
    assert {"simbench_msgs/msg/Consistency", "simbench_msgs/msg/StereoFeatures"} <= embedded.keys()
    for name, text in embedded.items():
        path = INTERFACES / "msg" / f"{name.rpartition('/')[2]}.msg"
        own = get_types_from_msg(path.read_text(), name)[name]
        assert get_types_from_msg(text.partition("=" * 80)[0], name)[name] == own


def test_package_builds_each_message_and_depends_on_what_they_are_made_of():
    package = ET.parse(INTERFACES / "package.xml").getroot()
    build = (INTERFACES / "CMakeLists.txt").read_text()
    assert package.findtext("name") == re.search(r"project\((\w+)\)", build)[1] == "simbench_msgs"
    assert package.findtext("member_of_group") == "rosidl_interface_packages"
    listed = re.findall(r"msg/\w+\.msg", build)
    assert listed == [f"msg/{p.name}" for p in sorted(INTERFACES.glob("msg/*.msg"))]
    used = {name for text in DEFINITIONS.values() for name in re.findall(r"(\w+)/\w+ ", text)}
    assert {node.text for node in package.findall("depend")} == used
    assert all(f"find_package({name} REQUIRED)" in build for name in used)
