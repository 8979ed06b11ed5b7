"""Every message of every topic through parsers that share no code with what wrote them."""

import json
import math
import shutil
import subprocess
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from mcap.reader import make_reader

from simbench.mcap import summary
from tests.simbench.recordings import drive, messages, record_drive

NODE = Path(__file__).parent / "readers"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    path = tmp_path_factory.mktemp("mcap") / "drive.mcap"
    return SimpleNamespace(path=path, record=record_drive(path, drive()))


def plain(value):
    """A message as numbers, text, lists and mappings; NaN as None, which JSON has for it."""
    if isinstance(value, dict):
        return {name: plain(inner) for name, inner in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, list | bytes):
        return [plain(inner) for inner in value]
    if is_dataclass(value):
        # What is no field of the message: its type, and constants, which ROS writes in capitals.
        names = [f.name for f in fields(value) if f.name != "__msgtype__" and f.name.islower()]
        return {name: plain(getattr(value, name)) for name in names}
    if hasattr(value, "__slots__"):
        return {name: plain(getattr(value, name)) for name in value.__slots__}
    return None if isinstance(value, float) and math.isnan(value) else value


@cache
def by_rosbags(path):
    return {t: [(ns, plain(m)) for ns, m in received] for t, received in messages(path).items()}


@cache
def by_mcap_ros2(path):
    decoder = pytest.importorskip("mcap_ros2.decoder", reason="mcap-ros2-support: in the dev extra")
    found = {}
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[decoder.DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages():
            found.setdefault(channel.topic, []).append((message.log_time, plain(decoded)))
    return found


@cache
def by_foxglove(path):
    if shutil.which("node") is None or not (NODE / "node_modules").is_dir():
        pytest.skip("needs node, and: npm --prefix tests/simbench/readers install")
    done = subprocess.run(
        ["node", NODE / "read_mcap.mjs", path], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    found = {}
    for topic, log_ns, message in map(json.loads, done.stdout.splitlines()):
        found.setdefault(topic, []).append((int(log_ns), message))
    return found


@cache
def by_rerun(path):
    chunk = pytest.importorskip("rerun.chunk", reason="rerun-sdk: in the viewer extra")
    found = {}
    for part in chunk.McapReader(path, decoders=["ros2_reflection"]).stream():
        batch = part.to_record_batch()
        (column,) = (name for name in batch.schema.names if name.endswith(":message"))
        times = batch.column("message_log_time").cast("int64").to_pylist()
        decoded = [plain(message) for (message,) in batch.column(column).to_pylist()]
        found.setdefault(part.entity_path, []).extend(zip(times, decoded, strict=True))
    return found


READERS = [by_rosbags, by_mcap_ros2, by_foxglove, by_rerun]


@pytest.mark.parametrize("read", READERS[1:])
def test_every_field_of_every_message_is_read_alike(made, read):
    expected, found = by_rosbags(made.path), read(made.path)
    assert found.keys() == expected.keys() == summary(made.path).counts.keys()
    for topic, received in expected.items():
        assert found[topic] == received, topic


@pytest.mark.parametrize("read", READERS)
def test_numbers_are_those_of_the_run_to_the_last_bit(made, read):
    topics, record = read(made.path), made.record
    dataset, truth = record.dataset, record.dataset.truth

    def of(topic, *names):
        found = [m for _, m in topics[topic]]
        for name in names:
            found = [m[name] for m in found]
        return found

    def positions(topic, *names):
        return [list(p.values()) for p in of(topic, *names, "position")]

    pose = "pose", "pose"
    smoothed = [belief.T_world_imu[:3, 3] for belief in record.smoothed]
    np.testing.assert_array_equal(positions("/estimate/pose", *pose), record.T_world_imu[:, :3, 3])
    np.testing.assert_array_equal(
        positions("/estimate/odometry", *pose), record.T_world_imu[:, :3, 3]
    )
    np.testing.assert_array_equal(
        positions("/ground_truth/pose", "pose"), truth.T_world_imu[:, :3, 3]
    )
    np.testing.assert_array_equal(positions("/smoothed/pose", *pose), smoothed)
    linear = [list(v.values()) for v in of("/twist", "twist", "twist", "linear")]
    np.testing.assert_array_equal(linear, dataset.linear_velocity)
    gyro = [list(v.values()) for v in of("/imu0", "angular_velocity")]
    np.testing.assert_array_equal(gyro, dataset.imu.gyro)
    nis = [step.innovation.nis for step in record.steps if step.innovation.dof]
    assert of("/consistency/nis", "value") == nis
    seen = np.concatenate(of("/stereo/features", "u0")).astype(float)
    np.testing.assert_array_equal(np.nan_to_num(seen, nan=-1), dataset.sightings.pixels[:, 0])
