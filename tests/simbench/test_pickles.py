"""Pickled dicts of arrays: read whatever numpy wrote them, and never run."""

import io
import os
import pickle
import struct
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simbench.errors import DatasetError
from simbench.limits import limited_to
from simbench.npz import read_npz
from simbench.npz.pickles import load_npy_dict

REAL_NAMES = ("v_t", "w_t", "timestamps", "features", "K_l", "K_r", "extL_T_imu", "extR_T_imu")


def example():
    rng = np.random.default_rng(1)
    shapes = ((7, 3), (7, 3), (7,), (4, 5, 7), (3, 3), (3, 3), (4, 4), (4, 4))
    return {name: rng.normal(size=shape) for name, shape in zip(REAL_NAMES, shapes, strict=True)}


def npy(pickled):
    """A `.npy` around the bytes of a pickle."""
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "|O", "fortran_order": False, "shape": ()})
    return head.getvalue() + pickled


def pickled_dict(value, protocol):
    boxed = np.empty((), object)
    boxed[()] = value
    return pickle.dumps(boxed, protocol)


def read(tmp_path, content):
    path = tmp_path / "dataset00.npy"
    path.write_bytes(content)
    return load_npy_dict(path)


def refused(tmp_path, content):
    with pytest.raises(DatasetError) as caught:
        read(tmp_path, content)
    assert str(caught.value).startswith(str(tmp_path / "dataset00.npy"))
    return str(caught.value)


def assert_same(found, expected):
    assert list(found) == list(expected)
    for name, array in expected.items():
        assert found[name].dtype == array.dtype
        np.testing.assert_array_equal(found[name], array)


# what is read


def test_what_numpy_saves_comes_back_to_the_bit(tmp_path):
    np.save(tmp_path / "d.npy", example())
    assert_same(load_npy_dict(tmp_path / "d.npy"), example())


@pytest.mark.parametrize("protocol", range(6))
@pytest.mark.parametrize("core", [b"numpy.core", b"numpy._core"])
def test_every_protocol_and_numpy_before_and_after_2_are_read(tmp_path, protocol, core):
    content = pickled_dict(example(), protocol)
    if protocol < 4:  # later names have a length before them
        content = content.replace(b"numpy._core", core)
    assert_same(read(tmp_path, npy(content)), example())


def test_orders_bytes_types_and_plain_values_are_read(tmp_path):
    a = np.arange(6.0).reshape(2, 3)
    value = {
        "fortran": np.asfortranarray(a),
        "big": a.astype(">f8"),
        "half": a.astype("f2"),
        "ints": a.astype("<i4"),
        "bools": a > 2,
        "text": "dataset 03",
        "nothing": None,
        "scalar": np.float64(0.6),
        "number": 0.6,
        "list": [[1, 2.5], [3, 4]],
        "mixed": (np.float64(1), 2, True),
        "empty": np.empty((4, 0, 7)),
    }
    np.save(tmp_path / "d.npy", value)
    found = load_npy_dict(tmp_path / "d.npy")
    assert (found.pop("text"), found.pop("nothing")) == ("dataset 03", None)
    for name, array in found.items():
        np.testing.assert_array_equal(array, value[name])
        assert isinstance(array, np.ndarray)
    assert found["big"].dtype == ">f8"


@given(
    st.dictionaries(
        st.text(max_size=5),
        st.recursive(st.floats(allow_nan=False) | st.text(max_size=3) | st.none(), st.lists),
        max_size=4,
    ),
    st.integers(0, 5),
)
def test_a_dict_of_plain_values_comes_back_or_is_refused_by_key(tmp_path_factory, value, protocol):
    try:
        found = read(tmp_path_factory.mktemp("d"), npy(pickled_dict(value, protocol)))
    except DatasetError as error:
        assert "expected an array" in str(error)  # noqa: PT017
    else:
        assert {
            k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in found.items()
        } == value


# what is refused


class Payload:
    """Leaves a trace when it is unpickled."""

    def __init__(self, function, *arguments):
        self.reduced = function, arguments

    def __reduce__(self):
        return self.reduced


def payloads(trace):
    import builtins
    import importlib
    import runpy
    import shutil

    touch = f"open({str(trace)!r}, 'w').close()"
    return {
        "posix.system": Payload(os.system, f"touch {trace}"),
        "builtins.eval": Payload(eval, touch),
        "builtins.exec": Payload(exec, touch),
        "builtins.open": Payload(open, str(trace), "w"),
        "builtins.getattr": Payload(getattr, os, "system")
        if False
        else Payload(getattr, 1, "real"),
        "subprocess.Popen": Payload(subprocess.Popen, ["touch", str(trace)]),
        "runpy.run_path": Payload(runpy.run_path, str(trace)),
        "importlib.import_module": Payload(importlib.import_module, "antigravity"),
        "shutil.rmtree": Payload(shutil.rmtree, str(trace)),
        "numpy.load": Payload(np.load, str(trace)),
        "builtins.__import__": Payload(builtins.__import__, "os"),
    }


@pytest.mark.parametrize("protocol", [0, 2, 4])
def test_a_payload_is_named_and_never_run(tmp_path, protocol):
    trace = tmp_path / "trace"
    for name, payload in payloads(trace).items():
        for value in (payload, {"v_t": payload}, {"v_t": [payload]}):
            message = refused(tmp_path, npy(pickled_dict(value, protocol)))
            assert name.rpartition(".")[2] in message, message
            assert "nothing was run" in message
    assert not trace.exists()


@pytest.mark.parametrize(
    ("program", "message"),
    [
        (b"\x80\x04cos\nsystem\n.", "os.system"),
        (b"(Vtouch x\nios\nsystem\n.", "os.system"),
        (b"\x80\x04\x82\x01.", "EXT1"),
        (b"\x80\x04Pid\n.", "PERSID"),
        (b"\x80\x04)\x81.", "NEWOBJ"),
        (b"\x80\x04\x8f.", "EMPTY_SET"),
        (b"cnumpy\ndtype.__class__\n.", "numpy.dtype.__class__"),
        (b"cnumpy\ndtype\n(U\x02O8I0\nI1\ntR.", "SHORT_BINSTRING"),
        (b"cnumpy\ndtype\n(VO4,O4\nI0\nI1\ntR.", "dtype 'O4,O4'"),
        (b"cnumpy\ndtype\nb.", "make no sense"),
        (b"\x80\x04}K\x01K\x02s.", "texts as keys"),
        (b"\x80\x04}))s.", "texts as keys"),
        (b"\x80\x04].", "expected a dict"),
        (b"\x80\x04", "before seeing STOP"),
        (b"", "exhausted before"),
        (b"\xff" * 40, "unknown"),
        (b".", "make no sense"),
        (b"t.", "make no sense"),
        (b"h\x07.", "make no sense"),
        (b"\x80\x04" + b"]" * 300_001 + b".", "more than 300000 values"),
        (b"I" + b"9" * 5000 + b"\n.", "4300"),
    ],
)
def test_a_program_that_is_no_dict_is_refused(tmp_path, program, message):
    assert message in refused(tmp_path, npy(program))


def test_other_files_are_refused(tmp_path):
    for content, message in (
        (b"", "expected a .npy file"),
        (pickle.dumps({}), "expected a .npy file"),
        (npy(pickled_dict({}, 4))[:40], "expected a .npy file of one dict"),
    ):
        assert message in refused(tmp_path, content)
    np.save(tmp_path / "a.npy", np.zeros((3, 4)))
    with pytest.raises(DatasetError, match=r"as np\.save"):
        load_npy_dict(tmp_path / "a.npy")
    with pytest.raises(DatasetError, match=r"expected a file that can be read: No such file"):
        load_npy_dict(tmp_path / "none.npy")
    with pytest.raises(DatasetError, match=r"expected a file that can be read: Is a directory"):
        load_npy_dict(tmp_path)


def test_a_file_above_the_limit_is_refused_until_the_limit_is_raised(tmp_path):
    np.save(tmp_path / "d.npy", example())
    with limited_to(1000), pytest.raises(DatasetError, match=r"limit of 1000 B.*--limit SIZE"):
        load_npy_dict(tmp_path / "d.npy")
    with limited_to(100_000):
        load_npy_dict(tmp_path / "d.npy")


# what would take all memory or all time


def array_of_claimed_shape(shape):
    """An array whose state says more than its bytes hold."""
    content = pickled_dict({"a": np.zeros(3)}, 2)
    return content.replace(b"K\x03\x85", pickle.dumps(shape, 2)[2:-1].replace(b"q\x00", b""))


def shared_lists(depth, width):
    value = 1.0
    for _ in range(depth):
        value = [value] * width
    return value


def tuples_as_key(depth):
    """Hashing it takes 2^depth steps."""
    return b"\x80\x04})" + b"2\x86" * depth + b"Ns."


BOMBS = {
    "memo index": npy(b"\x80\x04}r\xff\xff\xff\xff."),
    "bytearray8": npy(b"\x80\x05\x96" + struct.pack("<Q", 2**40) + b"x."),
    "binbytes8": npy(b"\x80\x04\x8e" + struct.pack("<Q", 2**40) + b"x."),
    "binunicode8": npy(b"\x80\x04\x8d" + struct.pack("<Q", 2**62) + b"x."),
    "frame": npy(b"\x80\x04\x95" + struct.pack("<Q", 2**62) + b"}."),
    "long4": npy(b"\x80\x02\x8b\xff\xff\xff\x7fx."),
    "shape of 10^12": npy(array_of_claimed_shape((10**12,))),
    "shape of 10^30": npy(array_of_claimed_shape((10**30, 10**30))),
    "negative shape": npy(array_of_claimed_shape((-1, -3))),
    "lists of lists": npy(pickle.dumps({"a": shared_lists(3, 10_000)}, 4)),
    "deep lists": npy(pickle.dumps({"a": shared_lists(60, 2)}, 4)),
    "a list for a dict": npy(pickle.dumps(shared_lists(60, 2), 4)),
    "lists for a shape": npy(array_of_claimed_shape(tuple(shared_lists(60, 2)))),
    "a shape of huge numbers": npy(array_of_claimed_shape((2**2000,) * 200_000)),
    "lists for a dtype": npy(
        b"\x80\x04cnumpy\ndtype\n" + pickle.dumps((shared_lists(60, 2),), 2)[2:-1] + b"R."
    ),
    "list in itself": npy(b"\x80\x04}\x8c\x01a]\x94h\x00as."),
    "tuples as key": npy(tuples_as_key(60)),
    "deep tuples": npy(b"\x80\x04}\x8c\x01a)" + b"\x85" * 500_000 + b"s."),
    "encoded again and again": npy(
        b"\x80\x04c_codecs\nencode\n\x94X"
        + struct.pack("<I", 2**20)
        + b"x" * 2**20
        + b"\x8c\x06latin1\x86\x940"
        + b"h\x00h\x01R" * 10_000
        + b"."
    ),
}
#: Read as the empty dicts that they are.
HARMLESS = {"memo index", "frame"}


@pytest.fixture(scope="module")
def answers(tmp_path_factory):
    """What a process with 1 GB of address space says of each bomb, with its seconds."""
    directory = tmp_path_factory.mktemp("bombs")
    for name, content in BOMBS.items():
        (directory / f"{name}.npy").write_bytes(content)
    script = (
        "import resource, sys, time\n"
        "from pathlib import Path\n"
        "from simbench.errors import DatasetError\n"
        "from simbench.npz.pickles import load_npy_dict\n"
        "resource.setrlimit(resource.RLIMIT_AS, (2**30, 2**30))\n"
        f"for path in sorted(Path({str(directory)!r}).iterdir()):\n"
        "    start = time.process_time()\n"
        "    try:\n"
        "        said = str(sorted(load_npy_dict(path)))\n"
        "    except DatasetError as error:\n"
        "        said = str(error)\n"
        "    print(path.stem, time.process_time() - start, said, sep='\\t')\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 0, done.stderr
    lines = [line.split("\t") for line in done.stdout.splitlines()]
    return {name: (float(seconds), said) for name, seconds, said in lines}


@pytest.mark.parametrize("name", BOMBS)
def test_a_bomb_is_refused_in_bounded_memory_and_time(answers, name):
    seconds, said = answers[name]
    assert said == "[]" if name in HARMLESS else ".npy: " in said
    assert seconds < 10


# what fuzzing found


def test_texts_that_look_like_numbers_are_none(tmp_path):
    message = refused(tmp_path, npy(pickled_dict({"v_t": ["0", "1"]}, 4)))
    assert "v_t: expected an array of numbers" in message


@pytest.mark.parametrize("features", [0.5, np.float64(-1), np.array(3)])
def test_features_of_one_number_are_refused(tmp_path, features):
    np.save(tmp_path / "d.npy", example() | {"features": features})
    with pytest.raises(DatasetError, match=r"features: expected an array, got one number"):
        read_npz(tmp_path / "d.npy")
