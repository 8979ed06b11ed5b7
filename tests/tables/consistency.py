"""Which filter stays consistent: the table of the README, made by one command.

    python -m tests.tables.consistency [--runs N] [CASE ...]

Every filter sees the same runs. NEES and its parts are over their degrees of freedom and averaged
over frames and runs; a band that holds for the runs at one instant is wider than that of such an
average, so what lies outside of it is off. Cost is processor time as a multiple of `slam`'s,
without the pass back.
"""

import time
from argparse import ArgumentParser
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed

from simbench.filters import resolve
from simbench.metrics import chi_square_band, nees, nis
from simbench.run import RunOptions, run
from simbench.scenario import load
from simbench.sensors import simulate
from vislam.lie import so3

SCENES = Path(__file__).parents[2] / "scenarios"
FILTERS = ("slam", "slam-fej", "slam-transport", "slam-invariant", "slam-iterated")
BAND = 0.999


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """A scene of the table.

    Attributes:
        about: what stands in the table.
        scene: its name.
        overrides: as of `--set`.
        runs: how many.
    """

    about: str
    scene: str
    overrides: tuple[str, ...] = ()
    runs: int


CASES = {
    "zhang1": Case(about="points, 1 %, 8 loops", scene="zhang", runs=100),
    "zhang5": Case(
        about="points, 5 %, 8 loops",
        scene="zhang",
        overrides=(
            "imu.velocity.share=0.05",
            "imu.angular_velocity.share=0.05",
            "point.share=0.05",
            "imu.velocity.sigma=0.02",
            "imu.angular_velocity.sigma=0.01",
            "point.floor_m=0.1",
        ),
        runs=100,
    ),
    "laps1": Case(about="stereo, 2 laps, 0.1 deg a step", scene="two_laps", runs=50),
    "laps5": Case(
        about="stereo, 2 laps, 0.5 deg a step",
        scene="two_laps",
        overrides=("imu.angular_velocity.sigma=[0.002, 0.002, 0.0436]",),
        runs=50,
    ),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """Averages over runs.

    Attributes:
        nees: of the pose, over 6.
        nees_rotation: of its rotation alone, over 3.
        nis: over its degrees of freedom.
        position_m: root mean square over frames and runs.
        rotation_deg: the same.
        cpu_ms: processor time a frame.
    """

    nees: float
    nees_rotation: float
    nis: float
    position_m: float
    rotation_deg: float
    cpu_ms: float


def one_run(case: Case, name: str, number: int) -> Row:
    """A row of one run alone."""
    dataset = simulate(load(SCENES / f"{case.scene}.yaml", case.overrides), run=number)
    start = time.process_time()
    record = run(dataset, resolve(name), options=RunOptions(memory_bytes=0))
    cpu_s = time.process_time() - start
    assert dataset.truth is not None
    true, found = dataset.truth.T_world_imu, record.T_world_imu
    errors, covariances = record.pose_errors, record.pose_covariances
    assert errors is not None
    assert covariances is not None
    unsure = covariances.any(axis=(-2, -1))
    errors, covariances = errors[unsure], covariances[unsure]
    turned = so3.log(np.swapaxes(found[:, :3, :3], -1, -2) @ true[:, :3, :3])
    value, dof = nis(record)
    return Row(
        nees=float(np.mean(nees(errors, covariances)) / 6),
        nees_rotation=float(np.mean(nees(errors[:, 3:], covariances[:, 3:, 3:])) / 3),
        nis=float(value.sum() / dof.sum()),
        position_m=_rms(np.linalg.norm((found - true)[:, :3, 3], axis=1)),
        rotation_deg=float(np.rad2deg(_rms(np.linalg.norm(turned, axis=1)))),
        cpu_ms=1000 * cpu_s / len(dataset),
    )


def measured(case: Case, name: str, runs: int, jobs: int = -1) -> Row:
    """A filter in a case, over so many runs."""
    rows = Parallel(n_jobs=jobs)(delayed(one_run)(case, name, k) for k in range(runs))

    def mean(key: str) -> float:
        return float(np.mean([getattr(row, key) for row in rows]))

    def rms(key: str) -> float:
        return _rms(np.array([getattr(row, key) for row in rows]))

    return Row(
        nees=mean("nees"),
        nees_rotation=mean("nees_rotation"),
        nis=mean("nis"),
        position_m=rms("position_m"),
        rotation_deg=rms("rotation_deg"),
        cpu_ms=mean("cpu_ms"),
    )


def band(runs: int, dof: int = 6) -> tuple[float, float]:
    """Where the mean NEES over its degrees of freedom lies at one instant of so many runs."""
    low, high = chi_square_band(dof, BAND, runs)
    return float(low) / dof, float(high) / dof


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


HEAD = """\
| scene | filter | pose NEES/6 | rotation NEES/3 | NIS | position m | rotation deg | cost |
|---|---|---|---|---|---|---|---|"""


def main() -> None:
    """Print the table."""
    parser = ArgumentParser(description="Print the table of consistent filters as Markdown.")
    parser.add_argument("cases", nargs="*", metavar="CASE", help=", ".join(CASES))
    parser.add_argument("--runs", type=int, help="instead of each case's own")
    told = parser.parse_args()
    if unknown := set(told.cases) - set(CASES):
        parser.error(f"expected cases among {', '.join(CASES)}, got {', '.join(sorted(unknown))}")
    print(HEAD)  # noqa: T201
    for case in (CASES[key] for key in told.cases or CASES):
        runs = told.runs or case.runs
        low, high = band(runs)
        paper_ms = None
        for name in FILTERS:
            row = measured(case, name, runs)
            paper_ms = paper_ms or row.cpu_ms
            mark = "" if low < row.nees < high else " (!)"
            print(  # noqa: T201
                f"| {case.about}, {runs} runs | `{name}` | {row.nees:.2f}{mark} | "
                f"{row.nees_rotation:.2f} | {row.nis:.3f} | {row.position_m:.3f} | "
                f"{row.rotation_deg:.3f} | {row.cpu_ms / paper_ms:.2f} |",
                flush=True,
            )
        print(f"| | 99.9 % band | {low:.2f} to {high:.2f} | | | | | |", flush=True)  # noqa: T201


if __name__ == "__main__":
    main()
