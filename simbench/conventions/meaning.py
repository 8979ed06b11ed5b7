"""What a file's extrinsics may hold, and what of it a user says."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np

from simbench.scenario.sensors import R_BODY_OPTICAL
from vislam.arrays import Array
from vislam.lie import se3

ImuFrame: TypeAlias = Literal["flu", "frd"]
Extrinsics: TypeAlias = Literal["imu_T_cam", "cam_T_imu", "mixed"]
CameraAxes: TypeAlias = Literal["optical", "regular"]

FLU_FRD = np.diag([1.0, -1.0, -1.0, 1.0])
REGULAR_OPTICAL = se3.from_rotation_translation(R_BODY_OPTICAL, np.zeros(3))


@dataclass(frozen=True, slots=True)
class Meaning:
    """What a file's extrinsics hold.

    Attributes:
        extrinsics: what the matrix is.
        imu_frame: the IMU frame that it means.
        camera_axes: those of the camera that it means.
    """

    extrinsics: Extrinsics
    imu_frame: ImuFrame = "flu"
    camera_axes: CameraAxes = "optical"

    def __str__(self) -> str:
        """As options and `info` name it, such as ``imu_T_cam/frd`` or ``cam_T_imu/flu/regular``."""
        regular = "" if self.camera_axes == "optical" else "/regular"
        return f"{self.extrinsics}/{self.imu_frame}{regular}"

    @classmethod
    def named(cls, name: str) -> "Meaning":
        """The inverse of `str`; a frame or axes that are left out are FLU and optical.

        Raises:
            ValueError: there is none of this name.
        """
        words = dict(zip(map(_KIND_OF.get, name.split("/")), name.split("/"), strict=True))
        if "extrinsics" not in words or None in words or len(words) <= name.count("/"):
            raise ValueError(
                "expected imu_T_cam, cam_T_imu or mixed, then /flu or /frd, then /optical or "
                f"/regular, got {name!r}"
            )
        return cls(**words)  # type: ignore[arg-type]  # words that were checked above

    def T_imu_cam(self, given: Array) -> Array:
        """Left optical frame to FLU, of a file's matrix, both shape (4, 4)."""
        T = given.copy() if self.extrinsics == "imu_T_cam" else se3.inverse(given)
        if self.extrinsics == "mixed":
            T[:3, 3] = given[:3, 3]
        if self.camera_axes == "regular":
            T = T @ REGULAR_OPTICAL
        return T if self.imu_frame == "flu" else FLU_FRD @ T

    def given(self, T_imu_cam: Array) -> Array:
        """The file's matrix that means this one: the inverse of `T_imu_cam`."""
        T = T_imu_cam.copy() if self.imu_frame == "flu" else FLU_FRD @ T_imu_cam
        if self.camera_axes == "regular":
            T = T @ REGULAR_OPTICAL.T
        if self.extrinsics == "imu_T_cam":
            return T
        given = se3.inverse(T)
        if self.extrinsics == "mixed":
            given[:3, 3] = T[:3, 3]
        return given


#: What each word of a name is.
_KIND_OF = {
    word: kind
    for kind, words in (
        ("extrinsics", Extrinsics),
        ("imu_frame", ImuFrame),
        ("camera_axes", CameraAxes),
    )
    for word in get_args(words)
}

#: What may be meant by the keys of the dialects; what the key's name claims stands first.
UNTIL_2020 = (
    *(Meaning(e, f) for e in ("cam_T_imu", "imu_T_cam", "mixed") for f in get_args(ImuFrame)),
)
FROM_2021 = (
    *(Meaning(e, f) for e in ("imu_T_cam", "cam_T_imu", "mixed") for f in get_args(ImuFrame)),
)
FROM_2025 = (
    *(Meaning(e, "flu", a) for e in ("cam_T_imu", "imu_T_cam") for a in get_args(CameraAxes)),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Overruled:
    """What a user says of a convention; None leaves it to the data."""

    extrinsics: Extrinsics | None = None
    imu_frame: ImuFrame | None = None
    camera_axes: CameraAxes | None = None

    def of(self, meanings: Sequence[Meaning]) -> tuple[Meaning, ...]:
        """The meanings that agree with it; one that is none of them is added as asked."""
        asked = [
            Meaning(
                self.extrinsics or meaning.extrinsics,
                self.imu_frame or meaning.imu_frame,
                self.camera_axes or meaning.camera_axes,
            )
            for meaning in meanings
        ]
        return tuple(dict.fromkeys(asked))


NOTHING = Overruled()
