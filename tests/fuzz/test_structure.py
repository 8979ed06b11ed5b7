"""Every key, shape, type and value of what is read, changed one at a time and several at once."""

import copy
import io
import json
import zipfile
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from mcap.records import Attachment, Message, Metadata

from simbench.mcap import container
from simbench.scenario.loading import loads
from tests.fuzz.harness import (
    READERS,
    SCENE,
    Tried,
    of_2025,
    try_input,
    whole,
    with_records,
    without_sums,
)

NUMBERS = [0.0, -1.0, 1.0, -0.0, np.nan, np.inf, -np.inf, 1e300, -1e300, 1e-300, 1e19, 2.0**63]
PLAIN = st.sampled_from(
    [*NUMBERS, 0, 1, -1, 3, 10**30, True, False, None, "", "x", "nan", "1e3", [], {}, [[]], [0] * 9]
)
DTYPES = st.sampled_from(
    ["f8", ">f8", "f4", "f2", "i1", "u8", "i8", "?", "c16", "U3", "S3", "M8[s]", "O", "f8,i4", "V8"]
)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return tmp_path_factory.mktemp("structure") / "input"


@st.composite
def changed_arrays(draw, arrays):
    """Some arrays with one or two changed, left out, or put under another name."""
    arrays = dict(arrays)
    for _ in range(draw(st.integers(1, 2))):
        key = draw(st.sampled_from(sorted(arrays)))
        array = np.array(arrays[key])
        match draw(st.sampled_from(["value", "values", "shape", "dtype", "name", "none", "new"])):
            case "value" if array.size and array.dtype.kind == "f":
                array.flat[draw(st.integers(0, array.size - 1))] = draw(st.sampled_from(NUMBERS))
                arrays[key] = array
            case "values" if array.dtype.kind == "f":
                arrays[key] = np.full(array.shape, draw(st.sampled_from(NUMBERS)))
            case "shape":
                arrays[key] = draw(
                    st.sampled_from(
                        [array.T, array.ravel(), array[None], array[..., :0], array[..., :1]]
                        if array.ndim
                        else [array[None], np.tile(array, (3, 3))]
                    )
                )
            case "dtype":
                try:
                    with np.errstate(all="ignore"):
                        arrays[key] = array.astype(draw(DTYPES))
                except (ValueError, TypeError, OverflowError):
                    pass
            case "name":
                arrays[draw(st.sampled_from([*sorted(arrays), "x", "../x", "\0"]))] = array
            case "none":
                del arrays[key]
            case "new":
                arrays[key] = np.array(draw(PLAIN), dtype=object)
    return arrays


@st.composite
def changed_tree(draw, tree):
    """Plain data with one to three places changed, left out or added."""
    tree = copy.deepcopy(tree)
    for _ in range(draw(st.integers(1, 3))):
        holder, key = draw(st.sampled_from(list(_places(tree))))
        match draw(st.sampled_from(["change", "change", "wrap", "none", "more"])):
            case "change":
                holder[key] = draw(PLAIN)
            case "wrap":
                holder[key] = [holder[key]] * draw(st.integers(1, 3))
            case "none":
                del holder[key]
            case "more" if isinstance(holder, dict):
                holder[draw(st.sampled_from(["x", "kind", "path", "text", ""]))] = draw(PLAIN)
        if not tree:
            return tree
    return tree


def _places(tree):
    items = tree.items() if isinstance(tree, dict) else enumerate(tree)
    for key, value in list(items):
        yield tree, key
        if isinstance(value, dict | list):
            yield from _places(value)


@cache
def npz_arrays():
    with np.load(io.BytesIO(whole(".npz"))) as file:
        return dict(file)


def read(kind, content, path) -> Tried:
    """As `try_input`, of a file's own bytes."""
    reader = READERS[kind]
    path = path.with_suffix(reader.suffix)
    path.write_bytes(content)
    return try_input(replace(reader, content=lambda data: data), content, path)


@given(st.data())
def test_npz(path, data):
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as zip_:
        for key, array in data.draw(changed_arrays(npz_arrays())).items():
            with zip_.open(f"{key}.npy", "w") as member:
                np.lib.format.write_array(member, np.asarray(array), allow_pickle=True)
    read("npz", file.getvalue(), path)


@given(st.data())
def test_npy(path, data):
    file = io.BytesIO()
    values = data.draw(changed_arrays(of_2025()))
    np.save(file, values, allow_pickle=True)
    read("npy", file.getvalue(), path)


@given(changed_tree(loads(SCENE).model_dump(mode="json", exclude_none=True)))
def test_scene(path, tree):
    read("scene", yaml.safe_dump(tree).encode(), path)


@cache
def recording():
    return without_sums(whole(".mcap"))


@cache
def records(path):
    path = path.with_suffix(".seed.mcap")
    path.write_bytes(recording())
    return list(container.Container(path).records())


@given(st.data())
def test_recording_whose_attachments_are_changed(path, data):
    changed = []
    for record in records(path):
        if isinstance(record, Attachment) and record.name == "calibration.json":
            tree = data.draw(changed_tree(json.loads(record.data)))
            changed.append(replace(record, data=json.dumps(tree).encode()))
        elif isinstance(record, Attachment) and record.name == "truth.npz":
            with np.load(io.BytesIO(record.data)) as file:
                arrays = data.draw(changed_arrays(dict(file)) | st.just(dict(file)))
            file = io.BytesIO()
            with zipfile.ZipFile(file, "w") as zip_:
                for key, array in arrays.items():
                    with zip_.open(f"{key}.npy", "w") as member:
                        np.lib.format.write_array(member, np.asarray(array), allow_pickle=True)
            changed.append(replace(record, data=file.getvalue()))
        else:
            changed.append(record)
    read("mcap", with_records(changed), path)


@given(st.data())
def test_recording_whose_metadata_and_messages_are_changed(path, data):
    changed = list(records(path))
    text = st.sampled_from(["", "x", "-1", "9" * 5000, "nan", "\0", "../..", "{}", "true"])
    for _ in range(data.draw(st.integers(1, 3))):
        i = data.draw(st.integers(0, len(changed) - 1))
        record = changed[i]
        match record:
            case Metadata():
                key = data.draw(st.sampled_from(sorted(record.metadata)))
                changed[i] = replace(record, metadata=record.metadata | {key: data.draw(text)})
            case Message():
                raw = bytearray(record.data)
                at = data.draw(st.integers(0, len(raw) - 1))
                raw[at : at + 4] = data.draw(st.sampled_from([b"\xff" * 4, bytes(4), b"", b"\x7f"]))
                log_time = data.draw(st.sampled_from([record.log_time, 0, 2**64 - 1]))
                changed[i] = replace(record, data=bytes(raw), log_time=log_time)
            case _:
                del changed[i]
    try:
        content = with_records(changed)
    except KeyError:  # a message without its channel cannot even be written
        return
    read("mcap", content, path)


@pytest.mark.parametrize("kind", ["npz", "npy", "mcap"])
@given(data=st.data())
def test_file_cut_off_and_with_other_bytes(path, kind, data):
    if kind == "npy":
        file = io.BytesIO()
        np.save(file, of_2025(), allow_pickle=True)
        raw = bytearray(file.getvalue())
    else:
        raw = bytearray(recording() if kind == "mcap" else archive())
    for _ in range(data.draw(st.integers(0, 4))):
        at = data.draw(st.integers(0, len(raw) - 1))
        raw[at] = data.draw(st.integers(0, 255))
    raw = raw[: data.draw(st.just(len(raw)) | st.integers(0, len(raw)))]
    read(kind, bytes(raw), path)


@cache
def archive():
    return whole(".npz")
