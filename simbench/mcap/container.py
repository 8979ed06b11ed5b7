"""The records of an MCAP file, ours or not, whole or cut off, within the limit of memory."""

import io
import struct
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Header, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import MCAP0_MAGIC, Writer

from simbench.errors import DatasetError
from simbench.files import read_bytes, replacing
from simbench.limits import refuse_above_limit

#: What a record takes beside its data, as objects of Python.
RECORD_BYTES = 512
#: What a byte takes in the records that become dicts and lists.
BYTES_PER_BYTE = 32
_PLAIN = {Opcode.MESSAGE, Opcode.ATTACHMENT, Opcode.CHUNK, Opcode.SCHEMA}


class Container:
    """An MCAP file in memory.

    Attributes:
        path: of the file.
        finished: whether it has its end.
    """

    def __init__(self, path: Path) -> None:
        """Read the file.

        Raises:
            DatasetError: it cannot be read, is above the limit, or is no MCAP.
        """
        data = read_bytes(path)
        if not data.startswith(MCAP0_MAGIC):
            raise DatasetError(
                f"{path}: expected an MCAP file, got one that starts with {data[:8]!r}."
            )
        self.path, self.finished = path, data.endswith(MCAP0_MAGIC) and len(data) > 8
        end, self._claimed_bytes = _whole_records(data, len(MCAP0_MAGIC), self.finished)
        self._data = data[:end]

    def records(self) -> Iterator[McapRecord]:
        """The whole records in their order, those of chunks in place of their chunk.

        Raises:
            DatasetError: the file is damaged, or claims more than the limit.
        """
        claimed_bytes = self._claimed_bytes
        self._refuse(claimed_bytes)
        reader = StreamReader(
            io.BytesIO(self._data), validate_crcs=True, emit_chunks=True, record_size_limit=None
        )
        try:
            for record in reader.records:
                if isinstance(record, Chunk):
                    self._refuse(claimed_bytes + record.uncompressed_size)
                    inner = _inflated(record)
                    end, inner_bytes = _whole_records(inner.data, 0)
                    if end != len(inner.data):
                        raise ValueError("the last record of a chunk lacks its end")
                    claimed_bytes += inner_bytes
                    self._refuse(claimed_bytes)
                    yield from breakup_chunk(inner, validate_crc=True)
                else:
                    yield record
        except EndOfFile as error:
            if self.finished:
                raise self._damaged("a record lacks its end") from error
        except DatasetError:
            raise
        except Exception as error:  # whatever a damaged record makes its parser raise
            raise self._damaged(str(error) or repr(error)) from error

    def _damaged(self, what: str) -> DatasetError:
        return DatasetError(f"{self.path}: the file is damaged: {what:.200}.")

    def _refuse(self, n_bytes: int) -> None:
        refuse_above_limit(str(self.path), "the recording, unpacked,", n_bytes)


def finish(partial: Path, path: Path) -> None:
    """Make a whole file of what a killed run left: the same records, and an end with an index.

    Its metadata still say that the run did not come to its end.

    Args:
        partial: the unfinished recording; it stays as it is. A finished one is copied.
        path: of the whole file.

    Raises:
        DatasetError: `partial` cannot be read, is no MCAP, or is damaged.
        OutputError: the operating system refused.
    """
    container = Container(partial)
    with replacing(path) as temporary, temporary.open("wb") as stream:
        writer: Any = Writer(stream, enable_data_crcs=True)
        known: dict[tuple[type, int], int] = {(Schema, 0): 0}
        try:
            for number, record in enumerate(container.records()):
                if (number == 0) != isinstance(record, Header):
                    raise DatasetError(f"{partial}: the file is damaged: expected one header.")
                _copy(record, writer, known)
        except KeyError as error:
            raise DatasetError(
                f"{partial}: the file is damaged: a record refers to one that is not there."
            ) from error
        writer.finish()


def _copy(record: McapRecord, writer: Any, known: dict[tuple[type, int], int]) -> None:
    """Write a record; `known` has the new numbers of schemas and channels."""
    match record:
        case Header(profile, library):
            writer.start(profile, library)
        case Schema() if (Schema, record.id) not in known:  # the index has each once more
            new = writer.register_schema(record.name, record.encoding, record.data)
            known[Schema, record.id] = new
        case Channel() if (Channel, record.id) not in known:
            schema = known[Schema, record.schema_id]
            known[Channel, record.id] = writer.register_channel(
                record.topic, record.message_encoding, schema, record.metadata
            )
        case Message():
            channel = known[Channel, record.channel_id]
            writer.add_message(
                channel, record.log_time, record.data, record.publish_time, record.sequence
            )
        case Attachment():
            writer.add_attachment(
                record.create_time, record.log_time, record.name, record.media_type, record.data
            )
        case Metadata():
            writer.add_metadata(record.name, record.metadata)


def _whole_records(data: bytes, start: int, finished: bool = False) -> tuple[int, int]:
    """Where the last record ends of which `data` hold every byte, and what the records take.

    Args:
        data: records one after another.
        start: where the first begins.
        finished: whether there is an end behind the last, which belongs to it.
    """
    at, claimed_bytes = start, 0
    while at + 9 <= len(data):
        opcode, length = struct.unpack_from("<BQ", data, at)
        if opcode == Opcode.FOOTER:
            return (len(data) if finished else at), claimed_bytes
        if at + 9 + length > len(data):
            break
        claimed_bytes += RECORD_BYTES + length * (1 if opcode in _PLAIN else BYTES_PER_BYTE)
        at += 9 + length
    return at, claimed_bytes


def _inflated(chunk: Chunk) -> Chunk:
    """A chunk as it was before compression, never longer than it says."""
    data, size = chunk.data, chunk.uncompressed_size
    match chunk.compression:
        case "zstd":
            import zstandard

            data = zstandard.ZstdDecompressor().stream_reader(data).read(size + 1)
        case "lz4":
            import lz4.frame

            data = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1)
        case "":
            pass
        case unknown:
            raise ValueError(f"a chunk is compressed as {unknown!r:.40}, expected zstd or lz4")
    if len(data) != size:
        raise ValueError(f"a chunk says that it holds {size} bytes, but has others")
    return replace(chunk, compression="", data=data)
