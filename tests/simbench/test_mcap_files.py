"""Recordings as files: read to the last bit; equal bytes; killed, cut off, damaged, foreign."""

import hashlib
import json
import os
import signal
import subprocess
import sys
from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import mcap
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import MCAP0_MAGIC, Writer

from simbench.dataset import Sightings, nanoseconds, seconds
from simbench.errors import DatasetError, OutputError
from simbench.mcap import read_dataset_mcap, record_to, summary, write_dataset_mcap
from simbench.run import run
from tests.simbench.recordings import (
    EPOCH_NS,
    FRAMES,
    METRICS,
    drive,
    messages,
    record_drive,
)
from vislam.filters import EkfSlam

ROOT = Path(__file__).parents[2]
UNIX_NS = 1_317_046_450_193_837_000


def bits(value):
    """A value as something that is equal only where every bit is."""
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    if is_dataclass(value):
        return {f.name: bits(getattr(value, f.name)) for f in fields(value)}
    return repr(value)


def first_frames(dataset, n):
    """The beginning of a dataset, as bits; the biases and samples of the raw IMU aside."""
    s, truth = dataset.sightings, dataset.truth
    cut = replace(
        dataset,
        times_s=dataset.times_s[:n],
        linear_velocity=dataset.linear_velocity[:n],
        angular_velocity=dataset.angular_velocity[:n],
        sightings=Sightings(
            start=s.start[: n + 1],
            ids=s.ids[: s.start[n]],
            pixels=s.pixels[: s.start[n]],
            last=s.last[: s.start[n]],
        ),
        truth=replace(
            truth,
            T_world_imu=truth.T_world_imu[:n],
            linear_velocity=truth.linear_velocity[:n],
            angular_velocity=truth.angular_velocity[:n],
        ),
        imu=None,
        notes=(),
    )
    return bits(cut)


def variants():
    whole = drive()
    features = whole.sightings
    unsure = replace(features, last=np.zeros(len(features), bool))
    return {
        "whole": whole,
        "of Unix times": drive(start_ns=UNIX_NS),
        "real": replace(drive(start_ns=UNIX_NS), truth=None, origin=None, imu=None, gate=None),
        "without features": replace(whole, sightings=None),
        "that does not know last sightings": replace(whole, sightings=unsure),
        "without any sighting": replace(
            whole, sightings=Sightings.from_frames([(np.empty(0, int), np.empty((0, 4)))] * FRAMES)
        ),
        "of one frame": drive(1),
        "with a known map": replace(
            whole,
            prior=replace(
                whole.prior,
                ids=np.arange(2),
                landmarks=whole.truth.landmarks[:2],
                landmark_covariances=np.tile(np.eye(3) / 3, (2, 1, 1)),
                joint_covariance=np.eye(12) / 7,
            ),
        ),
        "without biases of the imu": replace(
            whole, imu=replace(whole.imu, truth_gyro_bias=None, truth_accel_bias=None)
        ),
    }


@pytest.mark.parametrize("name", variants())
def test_dataset_comes_back_to_the_last_bit(tmp_path, name):
    dataset = variants()[name]
    write_dataset_mcap(tmp_path / "d.mcap", dataset)
    assert bits(read_dataset_mcap(tmp_path / "d.mcap")) == bits(dataset)


def test_dataset_comes_back_from_the_recording_of_a_run(tmp_path):
    record_drive(tmp_path / "r.mcap", drive())
    assert bits(read_dataset_mcap(tmp_path / "r.mcap")) == bits(drive())


def test_filter_on_a_dataset_read_back_ends_in_the_same_bits(tmp_path):
    write_dataset_mcap(tmp_path / "d.mcap", drive())
    again = read_dataset_mcap(tmp_path / "d.mcap")
    assert bits(run(again, EkfSlam).final) == bits(run(drive(), EkfSlam).final)


@given(st.integers(0, 2**31 * 10**9 - 1))
def test_whole_nanoseconds_survive_as_seconds_where_a_float_can_hold_them(ns):
    time_s = np.array([ns / 10**9])
    if ns < 2**52:
        assert nanoseconds(time_s).tolist() == [ns]
    assert seconds(nanoseconds(time_s)).tolist() == time_s.tolist()


def test_simulated_times_start_at_the_epoch_and_unix_times_stay(tmp_path):
    for start_ns, epoch_ns in ((0, EPOCH_NS), (UNIX_NS, 0)):
        dataset = drive(start_ns=start_ns)
        write_dataset_mcap(tmp_path / "d.mcap", dataset)
        found = summary(tmp_path / "d.mcap")
        assert found.metadata["epoch_ns"] == str(epoch_ns)
        first_ns = dataset.imu.times_ns[0] + epoch_ns
        assert messages(tmp_path / "d.mcap")["/tf_static"][0][0] == first_ns
        assert found.start_s == int(first_ns) / 10**9


@pytest.mark.parametrize("start_s", [-2e9, 2**31 - 2.0])
def test_times_that_no_ros_stamp_holds_are_refused(tmp_path, start_s):
    dataset = replace(drive(), times_s=start_s + np.arange(FRAMES), imu=None)
    with pytest.raises(DatasetError, match=r"drive: expected times that a ROS stamp holds"):
        write_dataset_mcap(tmp_path / "d.mcap", dataset)
    assert list(tmp_path.iterdir()) == []


def test_what_the_recording_says_of_itself(tmp_path):
    path = tmp_path / "r.mcap"
    record_drive(path, drive())
    with path.open("rb") as stream:
        reader = make_reader(stream)
        records = [(m.name, m.metadata) for m in reader.iter_metadata()]
        attached = {a.name: a for a in reader.iter_attachments()}
    expected = {
        "format_version": "1",
        "scenario": "drive",
        "seed": "7",
        "run": "3",
        "origin_version": "0.0.9",
        "filter": "truthful",
        "epoch_ns": str(EPOCH_NS),
    }
    for (name, metadata), finished in zip(records, ["false", "true"], strict=True):
        assert name == "simbench"
        assert metadata.items() >= expected.items()
        assert metadata["finished"] == finished
    assert attached.keys() == {"scenario.yaml", "calibration.json", "truth.npz", "metrics.json"}
    assert {a.create_time for a in attached.values()} == {0}
    assert attached["scenario.yaml"].data.decode() == drive().origin.scenario_yaml
    assert json.loads(attached["metrics.json"].data) == {
        k: v for k, v in METRICS.items() if k not in {"wall_s", "realtime_factor"}
    }
    told = json.loads(attached["calibration.json"].data)
    assert told["calibration"]["rig"]["fx_px"] == 552.554
    assert told["noise"]["sigma_px"] == drive().noise.sigma_px.tolist()
    assert told["gate"] == 0.999


def test_summary_counts_what_is_in_the_file(tmp_path):
    path = tmp_path / "d.mcap"
    write_dataset_mcap(path, drive())
    found, read = summary(path), messages(path)
    assert found.counts == {topic: len(received) for topic, received in read.items()}
    assert found.types["/twist"] == "geometry_msgs/msg/TwistWithCovarianceStamped"
    times = [ns for received in read.values() for ns, _ in received]
    assert found.duration_s == (max(times) - min(times)) / 1e9
    assert found.finished
    assert found.metadata["filter"] == ""
    assert found.attachments["scenario.yaml"] == len(drive().origin.scenario_yaml.encode())


def test_dataset_alone_hangs_its_sensors_on_the_truth(tmp_path):
    write_dataset_mcap(tmp_path / "d.mcap", drive(2))
    topics = messages(tmp_path / "d.mcap")
    parents = {t.child_frame_id: t.header.frame_id for t in topics["/tf_static"][0][1].transforms}
    assert parents["base_link"] == "base_link_gt"
    assert not any(topic.startswith(("/estimate", "/consistency")) for topic in topics)


def test_library_is_not_shadowed_by_the_module_of_the_same_name():
    assert Path(mcap.__file__).parent.parent.name == "site-packages"


SCRIPT = """
import sys
from pathlib import Path
from tests.simbench.recordings import Truthful, drive, record_drive
from simbench.mcap import write_dataset_mcap
record_drive(Path(sys.argv[1]), drive())
write_dataset_mcap(Path(sys.argv[2]), drive())
"""


def test_equal_inputs_give_equal_bytes_in_any_process(tmp_path):
    digests = set()
    for seed in ("1", "2"):
        paths = [tmp_path / f"{seed}.{kind}.mcap" for kind in ("run", "dataset")]
        subprocess.run(
            [sys.executable, "-c", SCRIPT, *paths],
            cwd=ROOT,
            env=os.environ | {"PYTHONHASHSEED": seed, "TZ": f"UTC{seed}"},
            check=True,
        )
        digests.add(tuple(hashlib.sha256(path.read_bytes()).hexdigest() for path in paths))
    assert len(digests) == 1


KILLED = """
import os, signal, sys
from pathlib import Path
from tests.simbench.recordings import Truthful, drive, record_drive

class Killed(Truthful):
    def update(self, frame):
        if self.frame == 27:
            os.kill(os.getpid(), signal.SIGKILL)
        return super().update(frame)

record_drive(Path(sys.argv[1]), drive(), Killed)
"""


def test_killed_run_can_be_read_up_to_its_last_second_and_says_that_it_is_unfinished(tmp_path):
    path = tmp_path / "r.mcap"
    done = subprocess.run([sys.executable, "-c", KILLED, path], cwd=ROOT, check=False)
    assert done.returncode == -signal.SIGKILL
    partial = tmp_path / "r.mcap.partial"
    assert list(tmp_path.iterdir()) == [partial]
    found = summary(partial)
    assert not found.finished
    assert found.metadata["finished"] == "false"
    assert found.metadata["filter"] == "truthful"
    dataset, again = drive(), read_dataset_mcap(partial)
    # Ten frames a second; the first frame of a second brings the last one to the disk.
    assert len(again) == found.counts["/estimate/pose"] == 20
    assert bits(again)["times_s"] == bits(dataset.times_s[:20])
    assert first_frames(again, 20) == first_frames(dataset, 20)
    n = np.count_nonzero(dataset.imu.times_s <= dataset.times_s[19])
    for name in ("times_s", "gyro", "accel", "truth_gyro_bias", "truth_accel_bias"):
        assert bits(getattr(again.imu, name)) == bits(getattr(dataset.imu, name)[:n])
    assert "unfinished" in again.notes[-1]


def stopped(path, error):
    """A recording that ends with an error in its third second."""
    with record_to(path, drive(), "slam") as recorder:
        for frame in range(25):
            recorder.frame(frame)
        raise error


def test_run_that_raises_leaves_the_earlier_recording_and_nothing_else(tmp_path):
    path = tmp_path / "r.mcap"
    path.write_bytes(b"earlier")
    with pytest.raises(KeyboardInterrupt):
        stopped(path, KeyboardInterrupt())
    assert list(tmp_path.iterdir()) == [path]
    assert path.read_bytes() == b"earlier"


def test_full_disk_is_one_clear_error(tmp_path):
    with pytest.raises(OutputError, match=r"Cannot write .*r\.mcap: No space left"):
        stopped(tmp_path / "r.mcap", OSError(28, "No space left on device"))
    assert list(tmp_path.iterdir()) == []


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    path = tmp_path_factory.mktemp("mcap") / "r.mcap"
    record_drive(path, drive())
    return path.read_bytes()


def test_recording_cut_off_anywhere_gives_its_first_frames_or_a_clear_error(tmp_path, whole):
    path, lengths = tmp_path / "cut.mcap", set()
    for size in [*range(0, len(whole), 4001), *range(len(whole) - 40, len(whole))]:
        path.write_bytes(whole[:size])
        if isinstance(again := read_or_error(path), str):
            continue
        # behind the mark of a whole recording stands the index alone
        assert "unfinished" in again.notes[-1] or bits(again) == bits(drive())
        assert first_frames(again, len(again)) == first_frames(drive(), len(again))
        lengths.add(len(again))
    assert len(lengths) >= 4
    assert max(lengths) == FRAMES


def test_no_damaged_byte_changes_what_a_filter_is_told(tmp_path, whole):
    path, refused = tmp_path / "damaged.mcap", 0
    places = np.random.default_rng(1).integers(8, len(whole) - 8, 150)
    for place in places:
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 0x55]) + whole[place + 1 :])
        again = read_or_error(path)
        if isinstance(again, str):
            refused += 1
        else:  # the index at the end is not read
            assert bits(again) == bits(drive())
    assert refused > 100


def test_changed_digit_of_what_a_filter_is_told_is_found(tmp_path, whole):
    path = tmp_path / "damaged.mcap"
    assert whole.count(b"552.554") == 2
    path.write_bytes(whole.replace(b"552.554", b"552.555"))
    assert "damaged" in read_or_error(path)


def read_or_error(path):
    """The dataset of a recording, or the error, which must name the file."""
    try:
        return read_dataset_mcap(path)
    except DatasetError as error:
        message = str(error)
    assert message.startswith(str(path))
    return message


def foreign(path, metadata):
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        schema = writer.register_schema("std_msgs/msg/Empty", "ros2msg", b"")
        channel = writer.register_channel("/empty", "cdr", schema)
        writer.add_message(channel, 5, b"\0\1\0\0", 5)
        if metadata:
            writer.add_metadata("simbench", metadata)
        writer.finish()


def test_recording_of_another_origin_is_refused_but_has_a_summary(tmp_path):
    foreign(tmp_path / "f.mcap", {})
    with pytest.raises(DatasetError, match=r"made by simbench.*\['/empty'\]"):
        read_dataset_mcap(tmp_path / "f.mcap")
    found = summary(tmp_path / "f.mcap")
    assert (found.counts, found.metadata, found.finished) == ({"/empty": 1}, {}, True)


def test_recording_of_a_later_format_is_refused(tmp_path):
    foreign(tmp_path / "f.mcap", {"format_version": "2", "version": "9.1"})
    with pytest.raises(DatasetError, match=r"format version 1, got 2, written by simbench 9\.1"):
        read_dataset_mcap(tmp_path / "f.mcap")


def test_recording_without_its_attachments_is_refused(tmp_path):
    foreign(tmp_path / "f.mcap", {"format_version": "1"})
    with pytest.raises(DatasetError, match=r"f\.mcap: the recording is damaged"):
        read_dataset_mcap(tmp_path / "f.mcap")


@pytest.mark.parametrize("read", [read_dataset_mcap, summary])
@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "No such file"),
        (b"", "expected an MCAP file"),
        (b"PK\3\4" + bytes(100), "expected an MCAP file, got one that starts with b'PK"),
        (MCAP0_MAGIC + b"\xff" * 50 + MCAP0_MAGIC, "damaged"),
    ],
    ids=["missing", "empty", "zip", "noise"],
)
def test_file_that_is_no_recording_is_one_clear_error(tmp_path, read, content, message):
    path = tmp_path / "x.mcap"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(DatasetError, match=message):
        read(path)


def test_directory_is_one_clear_error(tmp_path):
    with pytest.raises(DatasetError, match="directory"):
        read_dataset_mcap(tmp_path)
