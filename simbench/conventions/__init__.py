"""Which frames a foreign dataset means, found from its own data.

The format fixes the names of its keys but not what they hold. Three things differ between files
that exist:

* what the extrinsics are: `imu_T_cam` (left camera to IMU), `cam_T_imu` (its inverse), or `mixed`
  (the rotation of `cam_T_imu` beside the camera's position in the IMU frame);
* the IMU frame that they mean: `flu` (x forward, y left, z up), as the velocities, or `frd`
  (y right, z down), turned by diag(1, -1, -1) against the velocities;
* the axes of the camera: `optical` (x right, y down, z forward) or `regular` (x forward, y left,
  z up).

Each reading that a dialect leaves open predicts where the features of a frame are seen in the next
one: triangulated, moved with the measured twist, projected. The right one has the smallest error.
A sample may be a mean over the interval, as the format says, or instantaneous, as in real files;
then the mean of the samples at both frames is nearer. A reading is judged by the better of the two.
"""

from simbench.conventions.convention import Convention, resolve
from simbench.conventions.meaning import (
    FROM_2021,
    FROM_2025,
    NOTHING,
    UNTIL_2020,
    CameraAxes,
    Extrinsics,
    ImuFrame,
    Meaning,
    Overruled,
)
from simbench.conventions.motion import Motion
from simbench.conventions.reading import Reading

__all__ = [
    "FROM_2021",
    "FROM_2025",
    "NOTHING",
    "UNTIL_2020",
    "CameraAxes",
    "Convention",
    "Extrinsics",
    "ImuFrame",
    "Meaning",
    "Motion",
    "Overruled",
    "Reading",
    "resolve",
]
