"""Coverage-guided fuzzing of what reads a stranger's file: nothing but our own errors may come out.

    python -m tests.fuzz.harness READER SECONDS [DIRECTORY]

READER is one of `READERS`. Inputs that found new code are kept in DIRECTORY (and taken up again),
and one that made it fail in a file whose name is printed. Needs the extra ``fuzz``.

To get past check sums, an input is not always a file: of an `.npz` it is which member changes and
how, of a `.npy` the pickle, and recordings are made without sums.
"""

import io
import json
import pickle
import re
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

#: In the first byte of an input: the header stays, and only numbers change.
FILL = 128

SCENE = """
duration_s: 0.4
trajectory: {kind: circle, radius_m: 3, laps: 0.02}
landmarks: {kind: box, count: 60, size_m: [19, 19, 4]}
rig: {image_px: [1242, 376], depth_m: [1, 12]}
imu: {raw: {rate_hz: 20, gyro_noise_density: 1e-3}, velocity: {sigma: [0.1, 0.2, 0.3]}}
camera: {sigma_px: 0.5, tracks: {median_frames: 3}, walls: [[1, 2, 3, 4, 5]]}
prior: {sigma_rotation_deg: 1}
filter: {gate: 0.99}
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reader:
    """What is fuzzed.

    Attributes:
        suffix: of the files.
        seeds: gives inputs to begin with.
        content: the file's bytes from an input.
        at_header: matches the errors of inputs that did not get past the header.
    """

    suffix: str
    seeds: Callable[[], list[bytes]]
    content: Callable[[bytes], bytes]
    at_header: str


def whole(suffix: str) -> bytes:
    """A file of a small scene."""
    from simbench.mcap import write_dataset_mcap
    from simbench.npz import write_npz
    from simbench.scenario.loading import loads
    from simbench.sensors import simulate

    dataset = simulate(loads(SCENE))
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / f"whole{suffix}"
        (write_dataset_mcap if suffix == ".mcap" else write_npz)(path, dataset)
        return path.read_bytes()


def without_sums(recording: bytes) -> bytes:
    """A recording written again without compression and check sums."""
    from simbench.mcap import container

    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "whole.mcap"
        path.write_bytes(recording)
        return with_records(list(container.Container(path).records()))


def with_records(records: list[Any]) -> bytes:
    """A recording of some records, without compression and check sums."""
    from mcap.writer import CompressionType, Writer

    from simbench.mcap import container

    stream, known = io.BytesIO(), {(container.Schema, 0): 0}
    writer = Writer(stream, compression=CompressionType.NONE, enable_crcs=False)
    for record in records:
        container._copy(record, writer, known)
    writer.finish()
    return stream.getvalue()


@cache
def _members() -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(whole(".npz"))) as zip_:
        return {name: zip_.read(name) for name in zip_.namelist()}


def _archive(data: bytes) -> bytes:
    """An archive, of which the first byte says which member is changed, and the rest how."""
    which, data = data[0] if data else 0, data[1:]
    members = dict(_members())
    name = sorted(members)[which % len(members)]
    members[name] = _filled(members[name], data) if which & FILL else data
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as zip_:
        for key, content in members.items():
            zip_.writestr(key, content)
    return file.getvalue()


def _seeds_of_members() -> list[bytes]:
    raws = [raw for _, raw in sorted(_members().items())]
    return [
        *(bytes([i]) + raw for i, raw in enumerate(raws)),
        *(bytes([i]) + raw[-64:] for i, raw in enumerate(raws * 9) if i & FILL and i < 256),
    ]


def _filled(member: bytes, data: bytes) -> bytes:
    """An array's bytes with its header as it was and other numbers from the end backwards."""
    at = max(len(member) - len(data), member.index(b"\n") + 1)
    return member[:at] + data[: len(member) - at]


@cache
def of_2025() -> dict[str, object]:
    with np.load(io.BytesIO(whole(".npz"))) as file:
        T = file["imu_T_cam"]
        right = T.copy()
        right[:3, 3] += T[:3, 0] * file["b"]
        return {
            "v_t": file["linear_velocity"].T,
            "w_t": file["angular_velocity"].T,
            "timestamps": file["time_stamps"][0],
            "features": file["features"],
            "K_l": file["K"],
            "K_r": file["K"].tolist(),
            "extL_T_imu": np.linalg.inv(T),
            "extR_T_imu": np.linalg.inv(right),
        }


@cache
def _pickles() -> list[bytes]:
    boxed = np.empty((), object)
    boxed[()] = of_2025()
    return [pickle.dumps(boxed, protocol) for protocol in range(6)]


def _npy(data: bytes) -> bytes:
    """A `.npy` of a pickle: the rest of the input, or what the first byte says, filled from it."""
    which, data = data[0] if data else 0, data[1:]
    if which & FILL:
        values = dict(of_2025())
        key = sorted(values)[which % len(values)]
        raw = bytearray(np.asarray(values[key]).tobytes())
        raw[: len(data)] = data[: len(raw)]
        values[key] = np.frombuffer(raw, float).reshape(np.shape(values[key]))
        boxed = np.empty((), object)
        boxed[()] = values
        data = pickle.dumps(boxed)
    head = io.BytesIO()
    described = {"descr": "|O", "fortran_order": False, "shape": ()}
    np.lib.format.write_array_header_1_0(head, described)
    return head.getvalue() + data


READERS = {
    "npz": Reader(
        suffix=".npz",
        seeds=_seeds_of_members,
        content=_archive,
        at_header=r"expected an \.npz|cannot be read, the file is damaged|expected \.npy version",
    ),
    "npy": Reader(
        suffix=".npy",
        seeds=lambda: (
            [b"\0" + raw for raw in _pickles()]
            + [bytes([FILL | i]) + bytes(64) for i in range(len(of_2025()))]
        ),
        content=_npy,
        at_header="the pickled dict cannot be read",
    ),
    "mcap": Reader(
        suffix=".mcap",
        seeds=lambda: [without_sums(whole(".mcap"))],
        content=lambda data: data,
        at_header="expected an MCAP file|expected a recording made by simbench",
    ),
    "scene": Reader(
        suffix=".yaml",
        seeds=lambda: [SCENE.encode(), b"a: [1, {b: 2}]"],
        content=lambda data: data,
        at_header="expected YAML|expected text in UTF-8",
    ),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Tried:
    """How many inputs there were.

    Attributes:
        inputs: all.
        past_header: of these, the ones whose header was right.
        read: of these, the ones that were good to the end.
    """

    inputs: int = 0
    past_header: int = 0
    read: int = 0

    def __str__(self) -> str:
        share = self.past_header / max(self.inputs, 1)
        return f"{self.inputs} inputs, {share:.0%} past the header, {self.read} read"


def try_input(reader: Reader, data: bytes, path: Path) -> Tried:
    """Read one input, as `simbench info --json` does.

    Raises:
        Exception: whatever is not one of our own errors: that is the fault looked for.
    """
    from simbench.errors import SimbenchError
    from simbench.info import info

    path.write_bytes(reader.content(data))
    try:
        json.dumps(info(path), allow_nan=False)
    except SimbenchError as error:
        return Tried(inputs=1, past_header=not re.search(reader.at_header, str(error)))
    return Tried(inputs=1, past_header=1, read=1)


def fuzz(name: str, seconds: int, directory: Path) -> Tried:
    """Fuzz a reader in a process of its own.

    Args:
        name: one of `READERS`.
        seconds: how long.
        directory: keeps what found new code, what failed, and the counts.

    Raises:
        AssertionError: an input made it fail, hang or take too much memory; says which.
    """
    inputs = directory / "inputs"
    inputs.mkdir(parents=True, exist_ok=True)
    for i, seed in enumerate(READERS[name].seeds()):
        (inputs / f"seed-{i}").write_bytes(seed)
    limits = ["-timeout=30", "-rss_limit_mb=4000", "-max_len=200000", f"-max_total_time={seconds}"]
    arguments = [str(inputs), f"-artifact_prefix={directory}/", "-print_final_stats=1", *limits]
    done = subprocess.run(
        [sys.executable, "-m", "tests.fuzz.harness", "--within", name, str(directory), *arguments],
        cwd=Path(__file__).parents[2],
        capture_output=True,
        text=True,
        errors="replace",
        check=False,
    )
    assert done.returncode == 0, (done.stdout + done.stderr)[-5000:]
    return Tried(**json.loads((directory / "tried.json").read_text()))


def _within(name: str, directory: Path, arguments: list[str]) -> None:
    """Be the process that fuzzes; atheris ends it."""
    import atheris

    with atheris.instrument_imports(include=["simbench", "mcap", "zipfile", "pickletools"]):
        import simbench.info
        import simbench.mcap
        import simbench.npz
        import simbench.scenario.loading  # noqa: F401

    reader, tried = READERS[name], Tried()
    path = directory / f"input{reader.suffix}"

    def one(data: bytes) -> None:
        nonlocal tried
        new = try_input(reader, data, path)
        tried = replace(
            tried,
            inputs=tried.inputs + new.inputs,
            past_header=tried.past_header + new.past_header,
            read=tried.read + new.read,
        )
        counts = {field: getattr(tried, field) for field in ("inputs", "past_header", "read")}
        (directory / "tried.json").write_text(json.dumps(counts))

    atheris.Setup([sys.argv[0], *arguments], one)
    atheris.Fuzz()


if __name__ == "__main__":
    if sys.argv[1:2] == ["--within"]:
        _within(sys.argv[2], Path(sys.argv[3]), sys.argv[4:])
    kept = sys.argv[3] if len(sys.argv) > 3 else tempfile.mkdtemp(prefix="fuzz-")
    print(fuzz(sys.argv[1], int(sys.argv[2]), Path(kept)))  # noqa: T201
