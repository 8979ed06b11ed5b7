"""Small files that claim much, climb, or never end; each is named by what it is."""

import io
import json
import struct
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import lz4.frame
import numpy as np
import zstandard
from mcap.writer import CompressionType, Writer

MAGIC = b"\x89MCAP0\r\n"
HUGE = 2**62
SCENES = {
    "aliases": "a: &a [1, 1]\n"
    + "".join(f"{k}: &{k} [*{p}, *{p}]\n" for p, k in zip("abc", "bcd", strict=True)),
    "depth": "a: " + "[" * 100_000,
    "deep blocks": "".join(f"{' ' * i}a:\n" for i in range(3000)),
    "directives": "".join(f"%TAG !a{i}! b\n" for i in range(100_000)) + "---\nseed: 1\n",
    "unknown keys": "".join(f"k{i}: 1\n" for i in range(40_000)),
    "a long key": "k" * 1_000_000 + ": 1\n",
    "a long number": "seed: " + "9" * 1_000_000,
    "documents": "---\n" * 1_000_000,
    "frames": "duration_s: 1e12\nrate_hz: 1e9\n",
    "slow frames": "duration_s: 1e12\nrate_hz: 1e-9\nimu: {raw: {}}\n",
    "landmarks": "landmarks: {count: 1000000000}\n",
    "frames of landmarks": "duration_s: 90000\nlandmarks: {count: 1000000}\n",
    "huge numbers": "trajectory: {kind: circle, radius_m: 1e300}\n",
    "tiny numbers": "trajectory: {kind: circle, radius_m: 1e-300}\n",
    "a climbing name": "name: ../../climbed\n",
}


def scene(text: str) -> Callable[[Path], str]:
    def write(path: Path) -> str:
        path.write_text(text)
        return ".yaml"

    return write


def header(shape: tuple[int, ...], descr: str = "<f8") -> bytes:
    """Of an array, without it."""
    file = io.BytesIO()
    np.lib.format.write_array_header_2_0(
        file, {"descr": descr, "fortran_order": False, "shape": shape}
    )
    return file.getvalue()


def npz(members: dict[str, bytes | Iterator[bytes]]) -> Callable[[Path], str]:
    """An archive that is right but for some members."""

    def write(path: Path) -> str:
        T = 3
        arrays = {
            "time_stamps": np.arange(float(T))[None],
            "linear_velocity": np.ones((3, T)),
            "angular_velocity": np.ones((3, T)),
            "features": np.full((4, 2, T), -1.0),
            "K": np.diag([500.0, 500, 1]),
            "b": np.array(0.6),
            "imu_T_cam": np.eye(4),
        }
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as zip_:
            for key, array in arrays.items():
                if key not in members:
                    file = io.BytesIO()
                    np.save(file, array)
                    zip_.writestr(f"{key}.npy", file.getvalue())
            for key, content in members.items():
                with zip_.open(f"{key}.npy", "w", force_zip64=True) as member:
                    for part in [content] if isinstance(content, bytes) else content:
                        member.write(part)
        return ".npz"

    return write


def zeros(shape: tuple[int, ...]) -> Iterator[bytes]:
    """A whole array of zeros, a megabyte at a time."""
    yield header(shape)
    left = 8 * int(np.prod(shape))
    while left:
        part = min(left, 2**20)
        yield bytes(part)
        left -= part


def declared(key: str, size: int) -> Callable[[Path], str]:
    """An archive whose directory says that a member is larger than it is."""

    def write(path: Path) -> str:
        npz({key: header((1, size // 8))})(path)
        raw = bytearray(path.read_bytes())
        at = raw.rindex(f"{key}.npy".encode()) - 46
        raw[at + 24 : at + 28] = struct.pack("<I", size)
        path.write_bytes(raw)
        return ".npz"

    return write


def nested(path: Path) -> str:
    """An archive in an archive in an archive."""
    content = b"PK\5\6" + bytes(18)
    for _ in range(30):
        file = io.BytesIO()
        with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as zip_:
            zip_.writestr("features.npy", content)
        content = file.getvalue()
    return npz({"features": content})(path)


def many_members(path: Path) -> str:
    with zipfile.ZipFile(path, "w") as zip_:
        for i in range(20_000):
            zip_.writestr(f"{i}.npy", b"")
    return ".npz"


def record(opcode: int, body: bytes, length: int | None = None) -> bytes:
    return struct.pack("<BQ", opcode, len(body) if length is None else length) + body


def text(value: str, length: int | None = None) -> bytes:
    raw = value.encode()
    return struct.pack("<I", len(raw) if length is None else length) + raw


def mcap(*records: bytes) -> Callable[[Path], str]:
    """A file of a header and some records, with an end."""

    def write(path: Path) -> str:
        footer = record(2, bytes(20))
        path.write_bytes(
            MAGIC + record(1, text("ros2") + text("x")) + b"".join(records) + footer + MAGIC
        )
        return ".mcap"

    return write


def chunk(data: bytes, claimed: int, compression: str = "") -> bytes:
    body = struct.pack("<QQQI", 0, 0, claimed, 0) + text(compression)
    return record(6, body + struct.pack("<Q", len(data)) + data)


def ours(
    metadata: dict[str, str] | None = None,
    told: bytes | None = None,
    truth: bytes | None = None,
    messages: dict[str, tuple[str, bytes]] | None = None,
) -> Callable[[Path], str]:
    """A recording that says it is ours, with parts that are not right."""

    def write(path: Path) -> str:
        from simbench.mcap import attachments
        from simbench.mcap.provenance import provenance
        from tests.simbench.recordings import drive

        whole = drive(3)
        with path.open("wb") as stream:
            writer = Writer(stream, compression=CompressionType.NONE)
            writer.start("ros2")
            said = provenance(whole, None, {}, 0) | {"finished": "true"} | (metadata or {})
            writer.add_metadata("simbench", said)
            writer.add_attachment(0, 0, "../../climbed", "text/plain", b"up")
            writer.add_attachment(0, 0, "scenario.yaml", "", b"{}")
            writer.add_attachment(
                0, 0, "calibration.json", "", attachments.dump_told(whole) if told is None else told
            )
            if truth is not None:
                writer.add_attachment(0, 0, "truth.npz", "", truth)
            for topic, (kind, data) in (messages or {}).items():
                schema = writer.register_schema(kind, "ros2msg", b"")
                channel = writer.register_channel(topic, "cdr", schema)
                writer.add_message(channel, 5, data, 5)
            writer.finish()
        return ".mcap"

    return write


TWIST = "geometry_msgs/msg/TwistWithCovarianceStamped"
A_TWIST = {"/twist": (TWIST, b"\0\1\0\0" + bytes(8) + struct.pack("<I", 1) + bytes(4 + 48 + 288))}


def changed_told(**changes: object) -> bytes:
    from simbench.mcap import attachments
    from tests.simbench.recordings import drive

    return json.dumps(json.loads(attachments.dump_told(drive(3))) | changes).encode()


def truth_of_zeros() -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as zip_:
        zip_.writestr("landmarks.npy", b"".join(zeros((10_000_000,))))
    return file.getvalue()


def written(content: bytes, suffix: str) -> Callable[[Path], str]:
    def write(path: Path) -> str:
        path.write_bytes(content)
        return suffix

    return write


MESSAGES = b"".join(record(5, struct.pack("<HIQQ", 1, 0, 0, 0)) for _ in range(100_000))

BOMBS: dict[str, Callable[[Path], str]] = {
    **{f"scene with {name}": scene(text_) for name, text_ in SCENES.items()},
    "npz of 10^12 elements": npz({"features": header((4, 10**6, 10**6 // 4))}),
    "npz of 10^12 times": npz({"time_stamps": header((1, 10**12))}),
    "npz of zeros": npz({"features": zeros((4, 2**20, 8))}),
    "npz of many frames": npz({"time_stamps": zeros((1, 2**23))}),
    "npz that declares 4 GB": declared("time_stamps", 2**32 - 2**20),
    "npz in npz": nested,
    "npz of many members": many_members,
    "npz of a long header": npz({"b": b"\x93NUMPY\2\0" + struct.pack("<I", 2**31) + b"{" * 10**6}),
    "npz of a deep header": npz({"b": b"\x93NUMPY\2\0" + struct.pack("<I", 9999) + b"[" * 9999}),
    "mcap record of 2^62 bytes": mcap(record(5, b"", HUGE)),
    "mcap text of 4 GB": mcap(record(3, struct.pack("<H", 1) + text("x", 2**32 - 1))),
    "mcap attachment of 2^62 bytes": mcap(
        record(9, bytes(16) + text("a") + text("b") + struct.pack("<Q", HUGE))
    ),
    "mcap metadata of 4 GB": mcap(record(12, text("simbench") + struct.pack("<I", 2**32 - 1))),
    "mcap chunk of 2^62 bytes": mcap(chunk(b"", HUGE)),
    "mcap zstd of zeros": mcap(chunk(zstandard.compress(bytes(2**28)), 2**40, "zstd")),
    "mcap zstd of more than it says": mcap(chunk(zstandard.compress(bytes(2**28)), 100, "zstd")),
    "mcap lz4 of more than it says": mcap(chunk(lz4.frame.compress(bytes(2**28)), 100, "lz4")),
    "mcap zstd of many messages": mcap(
        *[chunk(zstandard.compress(100 * MESSAGES), 100 * len(MESSAGES), "zstd")] * 3
    ),
    "mcap zstd of a frame that claims": mcap(
        chunk(b"\x28\xb5\x2f\xfd\xe0" + struct.pack("<Q", HUGE) + b"\1\0\0", 2**20, "zstd")
    ),
    "mcap of another compression": mcap(chunk(b"", 0, "xz" * 10**6)),
    "mcap of messages shorter than their head": mcap(record(5, b"") * 100_000),
    "mcap of empty records": mcap(record(200, b"") * 500_000),
    "recording of 2^32 features": ours(
        messages=A_TWIST
        | {
            "/stereo/features": (
                "simbench_msgs/msg/StereoFeatures",
                b"\0\1\0\0" + bytes(8) + struct.pack("<I", 1) + bytes(4) + b"\xff" * 40,
            )
        }
    ),
    "recording of no numbers": ours({"epoch_ns": "9" * 5000}, messages=A_TWIST),
    "recording of deep json": ours(told=b"[" * 10**6, messages=A_TWIST),
    "recording of 10^12 landmarks": ours(
        told=changed_told(landmark_count=10**12), messages=A_TWIST
    ),
    "recording of texts for numbers": ours(told=changed_told(gate="x"), messages=A_TWIST),
    "recording of a truth of zeros": ours(truth=truth_of_zeros(), messages=A_TWIST),
    "recording of a twist of another type": ours(
        messages={"/twist": ("std_msgs/msg/String", b"\0\1\0\0\xff\xff\xff\xff")}
    ),
    "trajectory of one long line": written(b"1 " * 10**7, ".tum"),
    "trajectory of a long word": written(b"1" * 10**7, ".tum"),
    "trajectory of many lines": written(b"1\n" * 10**6, ".tum"),
    "trajectory above the limit": written(bytes(40 * 2**20), ".tum"),
    "trajectory of no text": written(b"\xff" * 100, ".tum"),
}
