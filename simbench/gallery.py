"""The pictures of the README: ``python -m simbench.gallery`` makes them all again.

In a clone, from its root: scenes are read from `scenarios/` and pictures written beside them. It
takes some minutes, most of them for the matrix.
"""

from collections.abc import Callable
from pathlib import Path

from joblib import Parallel, delayed
from matplotlib.figure import Figure
from PIL import Image

from simbench import figures
from simbench.bugs.matrix import matrix
from simbench.files import replacing
from simbench.filters import resolve
from simbench.run import RunRecord, run
from simbench.scenario import load
from simbench.sensors import simulate

SCENES = Path("scenarios")
#: The paper's three estimators.
PAPER = ("dead-reckoning", "mapping", "slam")
#: The same EKF with four ways to keep its covariance consistent.
CONSISTENT = ("slam", "slam-fej", "slam-transport", "slam-invariant")
#: For the mean of NEES, and for the power of the checks by chance.
NEES_RUNS, BUG_RUNS = 40, 200
#: Of a picture: with more it has three times the bytes and looks the same.
COLORS = 64


def figure8() -> Figure:
    """The paper's three estimators from above."""
    dataset = simulate(load(SCENES / "figure8.yaml"))
    return figures.trajectories([run(dataset, resolve(name), name=name) for name in PAPER])


def drive() -> Figure:
    """Dead reckoning and SLAM on a street, with landmarks in metres and along inverse depth."""
    dataset = simulate(load(SCENES / "drive.yaml"))
    names = ("dead-reckoning", "slam", "slam-inverse-depth")
    return figures.trajectories([run(dataset, resolve(name), name=name) for name in names])


def nees() -> Figure:
    """NEES of the filters side by side, where the heading is uncertain."""
    parallel = Parallel(n_jobs=-1)
    tasks = (delayed(_heading)(name, k) for name in CONSISTENT for k in range(NEES_RUNS))
    records = list(parallel(tasks))
    return figures.nees(
        {name: records[i * NEES_RUNS :][:NEES_RUNS] for i, name in enumerate(CONSISTENT)}
    )


def bugs() -> Figure:
    """Which check catches which mistake."""
    return figures.bugs(matrix(runs=BUG_RUNS))


GALLERY: dict[str, Callable[[], Figure]] = {
    draw.__name__: draw for draw in (figure8, drive, nees, bugs)
}


def save(figure: Figure, path: Path) -> None:
    """Write a PNG for the README, a third of the size that matplotlib makes it."""
    figures.save(figure, path)
    with Image.open(path) as picture:
        few = picture.convert("RGB").quantize(COLORS, dither=Image.Dither.NONE)
    with replacing(path) as partial:
        few.save(partial, format="PNG", optimize=True)


def _heading(name: str, run_number: int) -> RunRecord:
    dataset = simulate(load(SCENES / "heading.yaml"), run=run_number)
    return run(dataset, resolve(name), name=name)


if __name__ == "__main__":
    for name, draw in GALLERY.items():
        save(draw(), SCENES / f"{name}.png")
