"""The verb that makes one file of another."""

from pathlib import Path
from typing import Any

import click

from simbench.cli.options import CONVENTION, POSITIVE, options
from simbench.printing import show


@click.command()
@click.argument("source", metavar="IN", type=click.Path(path_type=Path))
@click.argument("target", metavar="OUT", type=click.Path(path_type=Path))
@click.option("--dialect", help="What OUT is to be where its suffix leaves that open; see above.")
@click.option(
    "--poses",
    "which",
    type=click.Choice(["truth", "estimate"]),
    help="Of a recording's; default: the estimate where it has one.",
)
@click.option("--rate-hz", type=POSITIVE, help="Of poses without times.")
@options(*CONVENTION)
def convert(
    source: Path,
    target: Path,
    dialect: str | None,
    which: Any,
    rate_hz: float | None,
    as_json: bool,
    **told: Any,
) -> None:
    """Make one file of another, and say what is lost.

    \b
    OUT         what it becomes
    .npz .npy   a dataset of --dialect YEAR, default 2022, or 2025 for .npy:
                  2019, 2020        cam_T_imu, rotational_velocity
                  2021              no features
                  2022, 2023, 2024  imu_T_cam, angular_velocity
                  2025, 2026        .npy: a pickled dict, two cameras
                Its extrinsics are self-consistent: in the frame of the velocities, what
                their key says. YEAR-as-distributed writes them as the course gave them out,
                YEAR:READING as any reading that `simbench info` lists, such as
                2022:imu_T_cam/frd or 2025:imu_T_cam/flu/regular.
    .mcap       a recording; an unfinished one (*.mcap.partial) becomes whole
    (none)      of a recording, a directory with metadata.yaml, for ROS tools that insist on one
    .tum .kitti .csv (EuRoC), or .txt with --dialect tum|kitti
                a trajectory; one of KITTI's has no times, so from it say --rate-hz

    What cannot be is refused: a trajectory has no readings, a real drive no true poses.
    """  # noqa: D301 (click wants the character)
    from simbench.convert import convert as convert_file
    from simbench.source import Told

    done = convert_file(
        source, target, dialect=dialect, which=which, rate_hz=rate_hz, told=Told(**told)
    )
    for note in done.notes:
        click.echo(note, err=True)
    values = {
        "read": done.read.value,
        "written": done.written,
        "lost": list(done.lost),
        "files": [str(target)],
    }
    show(values, as_json)
