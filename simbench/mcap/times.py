"""Times of a recording: where they start, and which frames the slower topics show."""

from simbench.dataset import Dataset
from simbench.errors import DatasetError

SECOND_NS = 10**9
#: 2020-01-01, added to simulated times: a stamp of zero means "no time" to ROS.
EPOCH_NS = 1_577_836_800 * SECOND_NS
#: From here on (2001-09-09) times are Unix time already.
FIRST_UNIX_NS = 10**9 * SECOND_NS
#: The seconds of a ROS stamp are an int32.
END_OF_TIME_NS = 2**31 * SECOND_NS


def epoch_ns(dataset: Dataset) -> int:
    """What is added to the dataset's times.

    Raises:
        DatasetError: a sum is no ROS stamp.
    """
    offset_ns = 0 if dataset.times_ns[0] >= FIRST_UNIX_NS else EPOCH_NS
    times_ns = [dataset.times_ns] + ([] if dataset.imu is None else [dataset.imu.times_ns])
    for ns in times_ns:
        if ns.size and not 0 < ns.min() + offset_ns <= ns.max() + offset_ns < END_OF_TIME_NS:
            raise DatasetError(
                f"{dataset.name}: expected times that a ROS stamp holds, from 0 s on or Unix time "
                f"up to 2038, got {ns.min() / 1e9} to {ns.max() / 1e9} s; shift them."
            )
    return offset_ns


def spaced(stamps_ns: list[int], spacing_ns: int) -> set[int]:
    """Frames at least so far apart, the last among them."""
    chosen, next_ns = set(), stamps_ns[-1]
    for frame in reversed(range(len(stamps_ns))):
        if stamps_ns[frame] <= next_ns:
            chosen.add(frame)
            next_ns = stamps_ns[frame] - spacing_ns
    return chosen
