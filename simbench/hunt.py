"""Searches scenes for one where a filter fails a check, and shrinks it to the smallest.

Hypothesis draws scenes from `simbench.strategies.scenarios` and simplifies the first that fails.
Its randomness comes from a seed and it has no database, so the same command finds the same scene.
(In a process with other modules the way there may be another: hypothesis tries constants of the
code that is loaded.) A hunt takes checks without chance: under a statistical one a shrink drifts.
"""

import random
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal, TypeAlias

from hypothesis import Phase, find, settings
from hypothesis.configuration import set_hypothesis_home_dir
from hypothesis.errors import NoSuchExample

from simbench.bugs import BUGS
from simbench.checks import conformance
from simbench.checks.audit import audit_drive
from simbench.checks.defaults import MOST_SCALARS
from simbench.checks.short_drive import ShortDrive
from simbench.errors import InputError
from simbench.files import file_safe, replacing
from simbench.filters import resolve
from simbench.mcap import write_dataset_mcap
from simbench.scenario import Scenario, load
from simbench.scenario.text import dump
from simbench.sensors import simulate
from simbench.strategies import scenarios
from vislam.filters import Factory

#: What a filter does wrong on a drive, in words; None where nothing is found.
Judge: TypeAlias = Callable[[Factory, ShortDrive], str | None]

MOST_FRAMES = 6
MOST_LANDMARKS = 6
#: Scenes drawn before a filter is let go.
MOST_DRAWN = 200


def judge(check: str) -> Judge:
    """The judge behind a check's name: `audit`, or one of `simbench.checks.conformance`.

    Raises:
        InputError: there is no such check, or it tells nothing of a scene.
    """
    if check == "audit":
        return _audited
    checked = conformance.resolve(check)
    if check in conformance.NOT_HUNTED:
        others = ", ".join(
            name for name in conformance.CHECKS if name not in conformance.NOT_HUNTED
        )
        raise InputError(
            f"Expected a check that judges the scene it is given, without chance; {check} has a "
            f"scene of its own or counts over many draws. A hunt takes audit, {others}."
        )

    def judged(factory: Factory, drive: ShortDrive) -> str | None:
        result = checked(factory, drive)
        return result.reason if result.failed else None

    return judged


def _audited(factory: Factory, drive: ShortDrive) -> str | None:
    result = audit_drive(factory, drive)
    return None if result.first is None else str(result.first)


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """A scene where a filter fails.

    Attributes:
        scenario: the scene.
        frames, landmarks: how many it has.
        reason: what fails where.
    """

    scenario: Scenario
    frames: int
    landmarks: int
    reason: str

    @property
    def size(self) -> tuple[int, int, int, str]:
        """What makes one scene smaller than another: frames, landmarks, the length of its file."""
        text = _yaml(self.scenario)
        return self.frames, self.landmarks, len(text), text


def _yaml(scenario: Scenario) -> str:
    """The scene file: the keys that were chosen; the rest is default, and no other file named."""
    return dump(scenario.model_dump(mode="json", exclude_unset=True))


@dataclass(frozen=True, slots=True, kw_only=True)
class Hunt:
    """What a hunt came to.

    Attributes:
        found: the smallest scene where the filter fails, None where there was none.
        tried: different scenes that were drawn.
        ended: "done", "time" where the seconds ran out, or "interrupted".
    """

    found: Found | None
    tried: int
    ended: Literal["done", "time", "interrupted"]


class _TimeIsUp(BaseException):
    """Not an Exception: hypothesis would take that for a failing scene."""


def hunt(
    factory: Factory,
    judge: Judge,
    *,
    clean: Factory | None = None,
    seed: int = 0,
    max_seconds: float = 60.0,
) -> Hunt:
    """Search for the smallest scene where a filter fails.

    Args:
        factory: makes the filter.
        judge: what it must pass.
        clean: a filter that must pass wherever `factory` fails, so that the scene shows the
            difference between the two and nothing else.
        seed: of the search.
        max_seconds: after which the smallest so far is given.
    """
    search = _Search(factory, judge, clean, time.monotonic() + max_seconds)
    ended: Literal["done", "time", "interrupted"] = "done"
    try:
        find(
            scenarios(MOST_FRAMES, MOST_LANDMARKS),
            search.fails,
            settings=settings(
                max_examples=MOST_DRAWN,
                phases=(Phase.generate, Phase.shrink),
                database=None,
                deadline=None,
            ),
            random=random.Random(seed),
        )
    except NoSuchExample:
        pass
    except _TimeIsUp:
        ended = "time"
    except KeyboardInterrupt:
        ended = "interrupted"
    smallest = min(search.found, key=lambda found: found.size, default=None)
    return Hunt(found=smallest, tried=len(search.judged), ended=ended)


class _Search:
    """Judges the scenes that hypothesis asks for, each once, and keeps those that fail."""

    def __init__(self, factory: Factory, judge: Judge, clean: Factory | None, end_s: float) -> None:
        self._factory, self._judge, self._clean, self._end_s = factory, judge, clean, end_s
        self.judged: dict[Scenario, bool] = {}
        self.found: list[Found] = []

    def fails(self, scenario: Scenario) -> bool:
        if scenario not in self.judged:
            if time.monotonic() > self._end_s:
                raise _TimeIsUp
            found = self._found(scenario)
            self.found += [found] if found else []
            self.judged[scenario] = found is not None
        return self.judged[scenario]

    def _found(self, scenario: Scenario) -> Found | None:
        try:
            dataset = simulate(scenario)
            drive = ShortDrive.of(dataset, MOST_SCALARS)
        except InputError:  # nothing is ever seen
            return None
        reason = self._judge(self._factory, drive)
        if reason is None or (self._clean and self._judge(self._clean, drive) is not None):
            return None
        return Found(
            scenario=scenario,
            frames=len(dataset),
            landmarks=dataset.landmark_count,
            reason=reason,
        )


def clean_of(name: str) -> Factory | None:
    """The filter that `BASE+BUG` would be without its bug; None for any other."""
    base, plus, bug = name.partition("+")
    if not plus:
        return None
    return resolve(BUGS[bug].base if base == "slam" else base)


@contextmanager
def nothing_left_behind() -> Iterator[None]:
    """Keep hypothesis's scratch directory out of the working directory.

    For a process that is all simbench's own: it overrules a directory that was set before.
    """
    with TemporaryDirectory() as directory:
        set_hypothesis_home_dir(directory)
        try:
            yield
        finally:
            set_hypothesis_home_dir(None)


def write(found: Found, name: str, check: str, out: Path) -> tuple[Path, Path]:
    """Write OUT/hunt-CHECK-NAME.yaml and .mcap, and return their paths.

    Args:
        found: the scene.
        name: of the filter.
        check: its name.
        out: the directory.
    """
    stem = file_safe(f"hunt-{check}-{name}")[:80]
    about = f"{name} fails the {check} here: {found.reason}"
    scenario = found.scenario.model_copy(update={"name": stem, "about": about})
    path, recording = out / f"{stem}.yaml", out / f"{stem}.mcap"
    with replacing(path) as partial:
        partial.write_text(_yaml(scenario), encoding="utf-8")
    write_dataset_mcap(recording, simulate(scenario))
    return path, recording


def fault_in(path: Path | str, name: str, check: str = "audit") -> str | None:
    """What a filter does wrong in a scene file, in words; None where nothing is found."""
    drive = ShortDrive.of(simulate(load(path)), MOST_SCALARS)
    return judge(check)(resolve(name), drive)


def line_for_test(path: Path, name: str, check: str) -> str:
    """To paste into a test: it fails until the filter is right."""
    return f'assert fault_in("{path.as_posix()}", "{name}", "{check}") is None'
