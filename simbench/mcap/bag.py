"""A recording as the directory that rosbag2 wrote before it read a file alone."""

import shutil
from pathlib import Path
from typing import Any

import yaml
from mcap.reader import make_reader
from mcap.records import Statistics
from mcap.summary import Summary

from simbench.errors import DatasetError
from simbench.files import replacing

#: The oldest in which offered QoS profiles stand as they do here; ROS 2 Humble and all later
#: releases read it.
METADATA_VERSION = 5


def write_bag_directory(mcap_path: Path, directory: Path) -> None:
    """Put a copy of a recording into a directory, beside the ``metadata.yaml`` of rosbag2.

    Args:
        mcap_path: a finished MCAP of profile ``ros2``.
        directory: made where there is none.

    Raises:
        DatasetError: the file cannot be read, is no MCAP, or has no index at its end.
        OutputError: the operating system refused.
    """
    metadata = yaml.safe_dump(_metadata(mcap_path.name, *_index(mcap_path)), sort_keys=False)
    with replacing(directory / mcap_path.name) as partial:
        shutil.copyfile(mcap_path, partial)
    with replacing(directory / "metadata.yaml") as partial:
        partial.write_text(metadata, encoding="utf-8")


def _index(path: Path) -> tuple[Summary, Statistics]:
    try:
        with path.open("rb") as stream:
            index = make_reader(stream).get_summary()
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read: {error.strerror or error}.") from error
    except Exception as error:  # whatever a damaged file makes its parser raise
        raise DatasetError(
            f"{path}: expected a finished MCAP file ({error}); one that was cut short is finished "
            "by simbench convert IN OUT.mcap."
        ) from error
    if index is None or index.statistics is None:
        raise DatasetError(f"{path}: expected an MCAP file with an index at its end, found none.")
    return index, index.statistics


def _metadata(name: str, index: Summary, statistics: Statistics) -> dict[str, Any]:
    start_ns = statistics.message_start_time
    span = {
        "starting_time": {"nanoseconds_since_epoch": start_ns},
        "duration": {"nanoseconds": statistics.message_end_time - start_ns},
        "message_count": statistics.message_count,
    }
    topics = [
        {
            "topic_metadata": {
                "name": channel.topic,
                "type": index.schemas[channel.schema_id].name,
                "serialization_format": channel.message_encoding,
                "offered_qos_profiles": channel.metadata.get("offered_qos_profiles", ""),
            },
            "message_count": statistics.channel_message_counts.get(channel.id, 0),
        }
        for channel in index.channels.values()
    ]
    return {
        "rosbag2_bagfile_information": {
            "version": METADATA_VERSION,
            "storage_identifier": "mcap",
            **span,
            "topics_with_message_count": topics,
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [name],
            "files": [{"path": name, **span}],
        }
    }
