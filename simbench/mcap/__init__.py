"""Recordings: a dataset, and a run over it, in one MCAP file that ROS tools and viewers open.

Profile ``ros2``; every channel is CDR with a ``ros2msg`` schema. Frames: ``map`` is the world and
``odom`` the same, ``base_link`` and ``imu`` are the body as estimated, ``cam0`` and ``cam1`` the
left and the right camera in optical axes, ``base_link_gt`` is the body in truth. Without a filter
``base_link`` is the body in truth.

| topic | when |
|---|---|
| `/tf_static`, `/ground_truth/path`, `/ground_truth/landmarks` | once, at the start |
| `/cam0/camera_info`, `/cam1/camera_info`, `/stereo/features`, `/twist` | each frame |
| `/point/features` | each frame, of a point sensor at ``cam0``; then none of the stereo pair's |
| `/imu0` | each raw sample |
| `/cam0/image/compressed`, `/cam1/image/compressed` | at most 20 a second: the features, drawn |
| `/tf`, `/ground_truth/odometry`, `/ground_truth/pose` | each frame |
| `/estimate/odometry`, `/estimate/pose` | each frame; covariance about the axes of ``map`` |
| `/estimate/path` | at most once a second |
| `/estimate/landmarks`, `/estimate/landmark_markers` | the same, and the whole map at the end |
| `/consistency/nees`, `/consistency/nis` | each frame that has one, with its 95 % band |
| `/smoothed/odometry`, `/smoothed/pose`, `/smoothed/path` | at the end, where the filter smooths |

In the pictures a feature is green where the filter used it, red where it refused it, white where it
did not test it. Smoothed poses are stamped with the time of their frame and logged at the end: only
then were they known, and log times stay in order. `simbench_msgs` beside this file is a ROS package
of our two own types: with it built, ``ros2 bag play`` and ``ros2 topic echo`` show them.
`layout.json` is a layout of these topics for Foxglove and Lichtblick.

A metadata record ``simbench`` says what the file is. It stands at the start with ``finished`` as
``false`` and again at the end with ``true``: the last one counts. With the attachments it holds
all that it takes to make the same numbers again: ``simbench run RECORD.mcap``. Attachments: what a
filter is told, with every digit, as ``calibration.json``; ``truth.npz``; ``scenario.yaml``;
``metrics.json``, without wall-clock figures.
"""

from simbench.mcap.bag import write_bag_directory
from simbench.mcap.reader import Summary, read_dataset_mcap, summary
from simbench.mcap.recorder import Recorder, record_to, write_dataset_mcap
from simbench.mcap.runs import RecordedRun, read_run_mcap

__all__ = [
    "RecordedRun",
    "Recorder",
    "Summary",
    "read_dataset_mcap",
    "read_run_mcap",
    "record_to",
    "summary",
    "write_bag_directory",
    "write_dataset_mcap",
]
