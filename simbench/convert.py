"""One file into another: datasets of any dialect, recordings, trajectories; and what is lost."""

import os
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np

from simbench.dataset import Dataset, Sightings
from simbench.errors import InputError, OutputError
from simbench.files import read_text
from simbench.npz.dialects import DEFAULT, SELF_CONSISTENT, Dialect
from simbench.poses import Format, Poses, format_of, parse_poses, write_poses
from simbench.source import NOTHING, Kind, Told, kind_of, open_source, refuse_misplaced
from vislam.arrays import Array

Which: TypeAlias = Literal["truth", "estimate"]
Target: TypeAlias = Dialect | Format | Literal["mcap", "bag"]

_BY_SUFFIX: dict[str, Target] = {
    ".npz": DEFAULT,
    ".npy": Dialect(year="2025", meaning=SELF_CONSISTENT["2025"]),
    ".mcap": "mcap",
    ".tum": Format.TUM,
    ".kitti": Format.KITTI,
    ".csv": Format.EUROC,
}
_SUFFIXES = {
    Format.TUM: (".tum", ".txt"),
    Format.KITTI: (".kitti", ".txt"),
    Format.EUROC: (".csv",),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Converted:
    """What became of a file.

    Attributes:
        read: what it was.
        written: what it is now: a year of a dialect with its reading, ``mcap``, ``bag``, or a
            format of trajectories.
        lost: what the new file does not hold, a line each.
        notes: what the reader found or chose.
    """

    read: Kind
    written: str
    lost: tuple[str, ...]
    notes: tuple[str, ...] = ()


def convert(
    source: Path,
    target: Path,
    *,
    dialect: str | None = None,
    which: Which | None = None,
    rate_hz: float | None = None,
    told: Told = NOTHING,
) -> Converted:
    """Write what one file holds as another.

    Args:
        source: a dataset, a recording (finished or not) or a trajectory.
        target: the new file; its suffix says what it is to be, none a bag directory.
        dialect: what it is to be where the suffix leaves that open: a name that `Dialect` knows,
            ``tum``, ``kitti`` or ``euroc``.
        which: of a recording's poses, for a trajectory; by default the estimate where it has one.
        rate_hz: of poses without times, for a trajectory that has some.
        told: overrules the convention found in a dataset.

    Raises:
        InputError: the source is not usable, or the conversion makes no sense.
        OutputError: the target cannot be written.
    """
    kind, wanted = kind_of(source), target_of(target, dialect)
    if target.exists() and target.samefile(source):
        raise InputError(f"{target}: expected another file than the source; choose another name.")
    if kind is Kind.SCENARIO:
        raise InputError(
            f"{source}: a scene holds no readings yet. `simbench generate {source}` makes them, "
            "with --dialect in any dialect."
        )
    _refuse_without_effect(kind, wanted, which, rate_hz)
    if wanted == "bag":
        refuse_misplaced(source, kind, told)
        return _bag(source, target, kind)
    if kind is Kind.TRAJECTORY:
        refuse_misplaced(source, kind, told)
        return _trajectory(source, target, wanted, rate_hz)
    if isinstance(wanted, Format):
        return _poses(source, target, wanted, kind, which, told)
    if wanted == "mcap" and kind is Kind.RECORDING:
        refuse_misplaced(source, kind, told)
        return _finish(source, target)
    dataset = open_source(source, told)
    if wanted == "mcap":
        from simbench.mcap import write_dataset_mcap

        write_dataset_mcap(target, dataset)
        return Converted(read=kind, written="mcap", lost=(), notes=dataset.notes)
    assert isinstance(wanted, Dialect)
    from simbench.npz import write_npz

    write_npz(target, dataset, wanted)
    lost = [*_run_of(source, kind), *_cut_off(source, kind), *lost_in(dataset, wanted)]
    return Converted(
        read=kind,
        written=f"{wanted.year}:{wanted.meaning}",
        lost=tuple(lost),
        notes=dataset.notes,
    )


def target_of(path: Path, dialect: str | None) -> Target:
    """What a new file is to be.

    Raises:
        InputError: suffix and dialect do not go together, or leave it open.
    """
    if dialect is None:
        if path.suffix == ".txt":
            raise InputError(f"{path}: TUM or KITTI? Say --dialect tum or --dialect kitti.")
        if not path.suffix or path.is_dir():
            return "bag"
        if path.suffix not in _BY_SUFFIX:
            raise InputError(
                f"{path}: expected one of the suffixes {', '.join(_BY_SUFFIX)}, or none for a bag "
                f"directory, got {path.suffix!r}."
            )
        return _BY_SUFFIX[path.suffix]
    if dialect in list(Format):
        suffixes: tuple[str, ...] = _SUFFIXES[Format(dialect)]
        wanted: Target = Format(dialect)
    else:
        wanted = Dialect.named(dialect)
        suffixes = (wanted.suffix,)
    if path.suffix not in suffixes:
        raise InputError(
            f"{path}: a file of --dialect {dialect} ends in {' or '.join(suffixes)}, got "
            f"{path.suffix or 'none'!r}."
        )
    return wanted


def lost_in(dataset: Dataset, dialect: Dialect) -> list[str]:
    """What a file of a dialect does not hold of a dataset, or holds otherwise."""
    T, sightings = dataset.calibration.T_imu_cam, dataset.sightings
    rounding = np.abs(dialect.meaning.T_imu_cam(dialect.meaning.given(T)) - T).max()
    level = 0
    if isinstance(sightings, Sightings):
        seen = (sightings.pixels != -1).all(axis=1)
        level = int(np.count_nonzero(seen & (sightings.pixels[:, 0] == sightings.pixels[:, 2])))
    still = int(np.count_nonzero(~dataset.angular_velocity.any(axis=1)))
    found = {
        f"the features: files of {dialect.year} have none": (
            sightings is not None and dialect.year == "2021"
        ),
        "the known map in the prior": len(dataset.prior.ids) > 0,
        f"{rounding:.1g} of the extrinsics, by the rounding of an inverse": rounding > 0,
        f"{still} rates of exactly zero, which readers divide by: they are 1e-15 rad/s": still,
        f"{level} disparities of exactly zero, which readers divide by: they are the smallest "
        "number above": level,
    }
    return [what for what, is_so in found.items() if is_so]


def _refuse_without_effect(
    kind: Kind, wanted: Target, which: Which | None, rate_hz: float | None
) -> None:
    to_poses = isinstance(wanted, Format)
    if which and not (to_poses and kind in (Kind.DATASET, Kind.RECORDING)):
        raise InputError("--poses goes with a trajectory made of a dataset or a recording.")
    if rate_hz and not (to_poses and kind is Kind.TRAJECTORY):
        raise InputError("--rate-hz goes with a trajectory made of one without times, a KITTI's.")


def _trajectory(source: Path, target: Path, wanted: Target, rate_hz: float | None) -> Converted:
    if not isinstance(wanted, Format):
        raise InputError(
            f"{source}: a trajectory holds no readings, so it cannot become {target.name}. To "
            "simulate along it, name it in a scene (trajectory: {kind: file, path: ...}) and "
            "`simbench generate` that."
        )
    text = read_text(source)
    poses, given = parse_poses(text, str(source)), format_of(text)
    lost = []
    if given is Format.EUROC and len(text.split("\n")[-2].split(",")) > 8:
        lost.append("the columns beyond the pose")
    if poses.times is None and wanted is not Format.KITTI:
        if rate_hz is None:
            raise InputError(
                f"{source}: poses of KITTI have no times, and {wanted} needs some; say at what "
                "rate they are: --rate-hz 10."
            )
        poses = poses.at_rate(rate_hz)
    elif rate_hz is not None:
        raise InputError(f"{source}: --rate-hz goes with poses without times; leave it out.")
    write_poses(target, poses, wanted)
    return Converted(
        read=Kind.TRAJECTORY,
        written=wanted.value,
        lost=(*lost, *_lost_of_times(poses, wanted)),
    )


def _poses(
    source: Path, target: Path, wanted: Format, kind: Kind, which: Which | None, told: Told
) -> Converted:
    """The true or the estimated poses of a dataset or a recording."""
    has_run = bool(_run_of(source, kind))
    which = which or ("estimate" if has_run else "truth")
    if which == "estimate" and not has_run:
        raise InputError(
            f"{source}: holds no estimate; `simbench run {source}` makes one, and its .tum."
        )
    if which == "estimate":
        from simbench.mcap import read_run_mcap

        refuse_misplaced(source, kind, told)
        record = read_run_mcap(source).record
        dataset, Ts = record.dataset, record.T_world_imu
    else:
        dataset = open_source(source, told)
        if dataset.truth is None:
            raise InputError(
                f"{source}: nobody knows the true poses of these data, so there is no trajectory "
                f"in them; `simbench run {source}` estimates one."
            )
        Ts = dataset.truth.T_world_imu
    poses = _timed(dataset, Ts)
    write_poses(target, poses, wanted)
    rest = f"all but the {'estimated' if which == 'estimate' else 'true'} poses at the frames"
    return Converted(
        read=kind,
        written=wanted.value,
        lost=(rest, *_cut_off(source, kind), *_lost_of_times(poses, wanted)),
        notes=dataset.notes,
    )


def _timed(dataset: Dataset, Ts_world_imu: Array) -> Poses:
    times = tuple(Decimal(ns) / 10**9 for ns in dataset.times_ns.tolist()[: len(Ts_world_imu)])
    return Poses(times=times, Ts_world_imu=Ts_world_imu)


def _lost_of_times(poses: Poses, wanted: Format) -> list[str]:
    if wanted is Format.KITTI:
        return ["the times"] if poses.times else []
    if wanted is Format.EUROC and any(t * 10**9 % 1 for t in poses.times or ()):
        return ["the digits of times below a nanosecond"]
    return []


def _run_of(source: Path, kind: Kind) -> list[str]:
    """The run that a recording holds beside its dataset."""
    if kind is not Kind.RECORDING:
        return []
    from simbench.mcap import summary

    name = summary(source).metadata.get("filter")
    return [f"the run of {name}: its estimates, covariances and metrics"] if name else []


def _cut_off(source: Path, kind: Kind) -> list[str]:
    """What a recording lacks because its run was killed."""
    if kind is not Kind.RECORDING:
        return []
    from simbench.mcap import summary

    found = summary(source)
    if found.metadata.get("finished") != "false":
        return []
    if not found.counts.get("/twist"):
        raise InputError(
            f"{source}: the run was cut short before its first second was written, so there is "
            "nothing to convert; run it again."
        )
    return [f"what came after the first {found.duration_s:g} s: the run was cut short"]


def _bag(source: Path, target: Path, kind: Kind) -> Converted:
    """The directory that some tools of ROS 2 insist on."""
    from simbench.mcap import write_bag_directory

    if kind is not Kind.RECORDING:
        raise InputError(
            f"{target}: a bag directory is made of a recording, but {source} is a {kind}; make it "
            "an .mcap first."
        )
    write_bag_directory(source, target)
    return Converted(read=kind, written="bag", lost=())


def _finish(source: Path, target: Path) -> Converted:
    """A whole recording of what a killed run left."""
    from simbench.mcap.container import finish

    lost = _cut_off(source, Kind.RECORDING)
    # Not at once to the target: what is written there is first called as a killed run's file is.
    whole = target.with_name(f"{target.name}.whole")
    finish(source, whole)
    try:
        os.replace(whole, target)
    except OSError as error:
        raise OutputError(f"Cannot write {target}: {error.strerror or error}.") from error
    return Converted(read=Kind.RECORDING, written="mcap", lost=tuple(lost))
