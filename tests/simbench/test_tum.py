import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simbench.errors import DatasetError, OutputError
from simbench.tum import parse_tum, read_tum, write_tum
from vislam.lie import se3


@given(seed=st.integers(0, 2**32), count=st.integers(1, 20), start=st.floats(0, 2e9))
def test_what_is_written_is_read_back(tmp_path_factory, seed, count, start):
    rng = np.random.default_rng(seed)
    times_s = start + np.cumsum(rng.uniform(1e-3, 1, count))
    Ts = se3.random(rng, (count,), sigma_translation=1e3)
    path = tmp_path_factory.mktemp("tum") / "a.tum"
    write_tum(path, times_s, Ts)
    read_times_s, read_Ts = read_tum(path)
    np.testing.assert_array_equal(read_times_s, times_s)
    np.testing.assert_array_equal(read_Ts[:, :3, 3], Ts[:, :3, 3])
    np.testing.assert_allclose(read_Ts, Ts, rtol=0, atol=2e-15 * 1e3)
    np.testing.assert_allclose(read_Ts[:, :3, :3], Ts[:, :3, :3], rtol=0, atol=3e-15)


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


def test_evo_reads_the_same(tmp_path):
    file_interface = pytest.importorskip("evo.tools.file_interface")
    rng = np.random.default_rng(1)
    Ts = se3.random(rng, (10,))
    write_tum(tmp_path / "a.tum", np.arange(10.0), Ts)
    trajectory = file_interface.read_tum_trajectory_file(tmp_path / "a.tum")
    np.testing.assert_array_equal(trajectory.timestamps, np.arange(10.0))
    np.testing.assert_allclose(np.array(trajectory.poses_se3), Ts, rtol=0, atol=1e-14)


def test_comments_blank_lines_and_rounded_quaternions_are_read():
    rows = parse_tum("# t x y z\n\n1 0 0 0 0 0 0.7071 0.7071 # first\n2 0 0 0 0 0 0 1\n")
    assert rows.shape == (2, 8)


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
    ],
)
def test_a_line_that_is_no_pose_is_named(tmp_path, text, message):
    (tmp_path / "a.tum").write_text(text)
    with pytest.raises(DatasetError, match=message):
        read_tum(tmp_path / "a.tum")


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(DatasetError, match=r"no.tum: expected a file"):
        read_tum(tmp_path / "no.tum")


def test_a_file_that_cannot_be_written_leaves_nothing_behind(tmp_path):
    (tmp_path / "a").write_text("in the way")
    with pytest.raises(OutputError, match="Cannot write"):
        write_tum(tmp_path / "a" / "b.tum", np.zeros(1), np.eye(4)[None])
    assert [path.name for path in tmp_path.iterdir()] == ["a"]
