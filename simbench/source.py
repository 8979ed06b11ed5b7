"""What a verb is pointed at: a scene, a dataset, a recording or a trajectory."""

from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path

from simbench.conventions import CameraAxes, Extrinsics, ImuFrame, Overruled
from simbench.dataset import Dataset
from simbench.errors import DatasetError, InputError
from simbench.files import size_of


class Kind(StrEnum):
    """Kinds of files."""

    SCENARIO = "scenario"
    DATASET = "dataset"
    RECORDING = "recording"
    TRAJECTORY = "trajectory"


_MAGIC = {b"PK": Kind.DATASET, b"\x93NUMPY": Kind.DATASET, b"\x89MCAP": Kind.RECORDING}
_TRAJECTORY_SUFFIXES = (".tum", ".txt", ".kitti", ".csv")


@dataclass(frozen=True, slots=True, kw_only=True)
class Told:
    """What a user says beside the source; None leaves it to the source.

    Attributes:
        seed, run: of a scene.
        overrides: ``key.path=value`` of a scene.
        imu_frame, extrinsics, camera_axes: the convention of a dataset.
        noise_pixel_px, noise_velocity, noise_angular: what a filter is told of a dataset's noise.
        gate: probability of the gate, or "none" to switch it off.
    """

    seed: int | None = None
    run: int | None = None
    overrides: tuple[str, ...] = ()
    imu_frame: ImuFrame | None = None
    extrinsics: Extrinsics | None = None
    camera_axes: CameraAxes | None = None
    noise_pixel_px: float | None = None
    noise_velocity: float | None = None
    noise_angular: float | None = None
    gate: float | str | None = None

    @property
    def convention(self) -> Overruled:
        """What is said of the convention."""
        return Overruled(
            extrinsics=self.extrinsics, imu_frame=self.imu_frame, camera_axes=self.camera_axes
        )


NOTHING = Told()


def kind_of(path: Path) -> Kind:
    """What a file is, by its first bytes, or where it is text by its suffix.

    Raises:
        InputError: there is no such file.
    """
    size_of(path)
    try:
        with path.open("rb") as stream:
            head = stream.read(8)
    except OSError as error:
        raise InputError(f"{path}: expected a file that can be read: {error.strerror}.") from error
    for magic, kind in _MAGIC.items():
        if head.startswith(magic):
            return kind
    if path.suffix in (".npz", ".npy"):
        return Kind.DATASET
    if path.suffix == ".mcap":
        return Kind.RECORDING
    return Kind.TRAJECTORY if path.suffix in _TRAJECTORY_SUFFIXES else Kind.SCENARIO


def open_source(path: Path | str, told: Told = NOTHING) -> Dataset:
    """The dataset that a file holds, or that its scene makes.

    Raises:
        InputError: the file is not usable, or an option does not go with its kind.
    """
    path = Path(path)
    kind = kind_of(path)
    refuse_misplaced(path, kind, told)
    dataset = _open(path, kind, told)
    if told.gate is None:
        return dataset
    return replace(dataset, gate=None if told.gate == "none" else float(told.gate))


def _open(path: Path, kind: Kind, told: Told) -> Dataset:
    if kind is Kind.SCENARIO:
        from simbench.scenario import load
        from simbench.sensors import simulate

        return simulate(load(path, told.overrides), told.seed, told.run or 0)
    if kind is Kind.DATASET:
        from simbench.npz import read_npz

        return read_npz(
            path,
            imu_frame=told.imu_frame,
            extrinsics=told.extrinsics,
            camera_axes=told.camera_axes,
            noise_pixel_px=told.noise_pixel_px,
            noise_velocity=told.noise_velocity,
            noise_angular=told.noise_angular,
        )
    if kind is Kind.RECORDING:
        from simbench.mcap import read_dataset_mcap

        return read_dataset_mcap(path)
    raise DatasetError(
        f"{path}: a trajectory holds no readings. To simulate along it, name it in a scene: "
        "trajectory: {kind: file, path: ...}."
    )


def refuse_misplaced(path: Path, kind: Kind, told: Told) -> None:
    """Refuse options that would be silently without effect.

    Raises:
        InputError: one was given that does not go with the kind.
    """
    of_kind: dict[Kind, dict[str, object]] = {
        Kind.SCENARIO: {"--seed": told.seed, "--run": told.run, "--set": told.overrides or None},
        Kind.DATASET: {
            "--imu-frame": told.imu_frame,
            "--extrinsics": told.extrinsics,
            "--camera-axes": told.camera_axes,
            "--noise-pixel-px": told.noise_pixel_px,
            "--noise-velocity": told.noise_velocity,
            "--noise-angular": told.noise_angular,
        },
    }
    for meant, options in of_kind.items():
        given = [name for name, value in options.items() if value is not None]
        if given and kind is not meant:
            raise InputError(
                f"{given[0]} goes with a {meant}, but {path} is a {kind}; leave it out"
                + (", or use --set." if kind is Kind.SCENARIO else ".")
            )
