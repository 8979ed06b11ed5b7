"""Trajectories in files: every digit, every format, and what is refused."""

from contextlib import suppress
from decimal import Decimal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simbench.errors import DatasetError, OutputError
from simbench.poses import (
    Format,
    Poses,
    format_of,
    format_poses,
    parse_poses,
    read_poses,
    write_tum,
)
from vislam.lie import se3


@given(seed=st.integers(0, 2**32), count=st.integers(1, 20), start=st.floats(0, 2e9))
def test_what_is_written_is_read_back(tmp_path_factory, seed, count, start):
    rng = np.random.default_rng(seed)
    times_s = start + np.cumsum(rng.uniform(1e-3, 1, count))
    Ts = se3.random(rng, (count,), sigma_translation=1e3)
    path = tmp_path_factory.mktemp("tum") / "a.tum"
    write_tum(path, times_s, Ts)
    read = read_poses(path)
    np.testing.assert_array_equal(read.times_s, times_s)
    np.testing.assert_array_equal(read.Ts_world_imu[:, :3, 3], Ts[:, :3, 3])
    np.testing.assert_allclose(read.Ts_world_imu[:, :3, :3], Ts[:, :3, :3], rtol=0, atol=3e-15)


@given(
    seed=st.integers(0, 2**32),
    ns=st.lists(st.integers(0, 2 * 10**18), min_size=1, max_size=20, unique=True),
    kind=st.sampled_from(Format),
)
def test_each_format_keeps_what_it_can_hold_to_the_last_bit(seed, ns, kind):
    """Whole nanoseconds too, of which a float64 has not the digits."""
    times = tuple(Decimal(n) / 10**9 for n in sorted(ns))
    Ts = se3.random(np.random.default_rng(seed), (len(ns),), sigma_translation=1e3)
    text = format_poses(Poses(times=times, Ts_world_imu=Ts), kind)
    assert format_of(text) is kind
    read = parse_poses(text)
    assert read.times == (None if kind is Format.KITTI else times)
    np.testing.assert_array_equal(read.Ts_world_imu[:, :3, 3], Ts[:, :3, 3])
    np.testing.assert_allclose(read.Ts_world_imu, Ts, rtol=0, atol=3e-15)
    if kind is Format.KITTI:
        assert read.Ts_world_imu.tobytes() == Ts.tobytes()


def test_elapsed_times_do_not_round_as_large_times_do():
    """At 1.4e9 s a float64 steps by 2.4e-7 s; a spline would make accelerations of that."""
    text = "1403636579763555584,0,0,0,1,0,0,0\n1403636579768555585,0,0,0,1,0,0,0\n"
    assert parse_poses(text).elapsed_s.tolist() == [0.0, 0.005000001]
    text = "1403636579.763555584 0 0 0 0 0 0 1\n1403636579.768555585 0 0 0 0 0 0 1\n"
    assert parse_poses(text).elapsed_s.tolist() == [0.0, 0.005000001]


def test_a_file_of_euroc_has_its_head_and_the_scalar_first():
    T = np.eye(4)
    T[:3] = [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3]]
    text = format_poses(Poses(times=(Decimal("1.5"),), Ts_world_imu=T[None]), Format.EUROC)
    head, line = text.splitlines()
    assert head.startswith("#timestamp [ns],p_RS_R_x [m]")
    ns, *numbers = line.split(",")
    assert ns == "1500000000"
    np.testing.assert_allclose(
        np.array(numbers, float), [1, 2, 3, 0.5**0.5, 0, 0, 0.5**0.5], atol=1e-15
    )


def test_the_further_columns_of_euroc_are_passed_over():
    row = "1403636580838555648,4.6,-1.7,0.7,0.5,-0.1,-0.8,0.1" + ",0.1" * 9
    with pytest.raises(DatasetError, match="quaternions of length 1"):
        parse_poses(row)
    row = "1403636580838555648,4.6,-1.7,0.7,0.534108,-0.153029,-0.827383,-0.082152" + ",0.1" * 9
    poses = parse_poses(f"#timestamp, p_RS_R_x [m]\n{row}\n")
    assert poses.Ts_world_imu[0, :3, 3].tolist() == [4.6, -1.7, 0.7]


def test_the_columns_are_time_position_and_quaternion_with_the_scalar_last(tmp_path):
    T = np.eye(4)
    T[:3] = [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3]]  # a quarter turn about z
    write_tum(tmp_path / "a.tum", np.array([1e9 + 0.1]), T[None])
    time, *position, qx, qy, qz, qw = (tmp_path / "a.tum").read_text().split()
    assert float(time) == 1e9 + 0.1
    assert [float(word) for word in position] == [1, 2, 3]
    np.testing.assert_allclose(
        np.array([qx, qy, qz, qw], float), [0, 0, 0.5**0.5, 0.5**0.5], atol=1e-16
    )


def test_comments_blank_lines_and_rounded_quaternions_are_read():
    poses = parse_poses("# t x y z\n\n1 0 0 0 0 0 0.7071 0.7071 # first\n2 0 0 0 0 0 0 1\n")
    assert poses.times_s.tolist() == [1, 2]


def test_matrices_of_few_digits_become_rotations():
    (T,) = parse_poses("0.8 -0.6 0 1 0.6001 0.8 0 2 0 0 1 3\n").Ts_world_imu
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-15)
    assert T[:3, 3].tolist() == [1, 2, 3]


#: Words that float, Decimal and int take in different ways.
awkward = st.sampled_from(
    [
        *("1e-999999999", "1e400", "1e40", "9.3e9", "-1e300", "1_0", "nan", "inf", "0x1", "1e", ""),
        *("1e-99999999999999999999999", "0e9999999999", "1." + "3" * 500, "9" * 400, "-0.0", "٣"),
    ]
)


@given(
    rows=st.lists(st.lists(awkward | st.floats().map(repr), max_size=13), max_size=4),
    comma=st.sampled_from([" ", ",", ", "]),
)
def test_a_strangers_words_are_poses_or_an_error_of_ours(rows, comma):
    text = "\n".join(comma.join(row) for row in rows)
    with suppress(DatasetError):
        poses = parse_poses(text)
        assert np.isfinite(poses.elapsed_s).all()
        for kind in Format if poses.times else [Format.KITTI]:
            assert len(format_poses(poses, kind)) < 10_000


@given(
    word=awkward,
    comma=st.sampled_from([" ", ","]),
)
def test_a_strangers_time_is_a_time_or_an_error_of_ours(word, comma):
    text = comma.join([word, "0", "0", "0", *(["0", "0", "0", "1"] if comma == " " else "1000")])
    with suppress(DatasetError):
        (time,) = parse_poses(text).times_s
        assert abs(time) < 9.3e9
        for kind in Format:
            assert len(format_poses(parse_poses(text), kind)) < 1000


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("# nothing\n", "a.tum: expected rows of 8 numbers, got none"),
        ("0 0 0 0 0 0 0 1\n1 2\n", "a.tum:2: expected 8 numbers, got 2"),
        ("0 0 0 0 0 0 0 one\n", "a.tum:1: expected 8 numbers: could not convert .* 'one'"),
        ("0 0 nan 0 0 0 0 1\n", "a.tum:1: expected finite numbers"),
        ("0 0 inf 0 0 0 0 1\n", "a.tum:1: expected finite numbers"),
        (
            "1 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n",
            "increasing times, but pose 2 is at 1.0 s after 1.0",
        ),
        ("0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 2\n", "of length 1, but that of pose 2 has length 2"),
        ("0 0 0 0 0 0 0 0\n", "of length 1, but that of pose 1 has length 0"),
        ("1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 1 0 0 0 0 1\n", "a.tum:2: expected 12 numbers"),
        ("1 0 0 0 0 1 0 0 0 0 -1 0\n", r"R\^T R = I and det R = 1, but pose 1 is off by"),
        ("5,0,0,0,1,0,0,0\n4,0,0,0,1,0,0,0\n", "increasing times, but pose 2"),
        ("1403636579763555584 0 0 0 0 0 0 1\n", "expected times in seconds, got 14036365797635"),
        ("5,0,0,0,1\n", "a.tum:1: expected 8 numbers, got 5"),
    ],
)
def test_a_line_that_is_no_pose_is_named(tmp_path, text, message):
    (tmp_path / "a.tum").write_text(text)
    with pytest.raises(DatasetError, match=message):
        read_poses(tmp_path / "a.tum")


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(DatasetError, match=r"no\.tum: "):
        read_poses(tmp_path / "no.tum")


def test_a_file_that_cannot_be_written_leaves_nothing_behind(tmp_path):
    (tmp_path / "a").write_text("in the way")
    with pytest.raises(OutputError, match="Cannot write"):
        write_tum(tmp_path / "a" / "b.tum", np.zeros(1), np.eye(4)[None])
    assert [path.name for path in tmp_path.iterdir()] == ["a"]
