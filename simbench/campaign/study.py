"""The study file: what a campaign runs, validated like a scenario.

`load` reads one, or makes one of a single scenario; `Plan` is what it comes to.
"""

from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator

from simbench.checks.conformance import resolve as resolve_check
from simbench.errors import Fault, InputError, ScenarioError
from simbench.filters import resolve
from simbench.scenario.loading import name_of, put, read, scenario_of, validated
from simbench.scenario.scene import Scenario
from simbench.scenario.text import Document, Location, dump, parse
from simbench.scenario.values import Count, Integer, Positive, Section, Text, WordOr, fault

#: A point of a sweep: what it changes, by keys as `--set` takes them.
Overrides = Mapping[str, Any]


class Study(Section):
    """The keys of a study file; `simbench.campaign` shows one."""

    name: Annotated[Text, Field(pattern=r"^\w[\w.+-]*$", max_length=80)] = "study"
    about: Text = ""
    scenarios: Annotated[
        tuple[WordOr[Text, dict[str, Any]], ...], Field(min_length=1, validate_default=True)
    ] = ()
    """Files beside the study's, or whole scenes."""
    filters: Annotated[tuple[Text, ...], Field(min_length=1)] = ("slam",)
    runs: Count = 50
    seed: Annotated[Integer, Field(ge=0, lt=2**63)] | None = None
    """Default: each scenario's own."""
    sweep: Annotated[tuple[dict[str, tuple[Any, ...]], ...], Field(min_length=1)] = ({},)
    smooth: Annotated[bool, Field(strict=True)] = False
    """Whether the past poses are wanted given all data, too."""
    checks: tuple[Text, ...] = ()
    outputs: tuple[Literal["parquet", "series"], ...] = ()
    time_limit_s: Positive = 600.0
    """For one filter on one run; beyond it, it hangs."""

    @field_validator("sweep", mode="before")
    @classmethod
    def _grids(cls, value: Any) -> Any:
        """A mapping is one grid, and a value that is no list one value."""
        grids = [value] if isinstance(value, dict) else value
        if not isinstance(grids, list | tuple) or not all(isinstance(g, dict) for g in grids):
            raise fault(
                "expected a mapping of keys to values, or a list of such, got {v!r}", v=value
            )
        for key, values in ((k, v) for grid in grids for k, v in grid.items()):
            if values in ([], None):
                raise fault("expected a value or a list of them, got none", key=key)
        return [
            {k: v if isinstance(v, list | tuple) else [v] for k, v in grid.items()}
            for grid in grids
        ]

    @field_validator("filters", "checks", "outputs")
    @classmethod
    def _once_each(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for i, name in enumerate(value):
            if name in value[:i]:
                raise fault("expected each name once, got {name} twice", name=name)
        return value

    @field_validator("filters")
    @classmethod
    def _are_filters(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for name in value:
            _known(resolve, name)
        return value

    @field_validator("checks")
    @classmethod
    def _are_checks(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for name in value:
            _known(resolve_check, name)
        return value


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """One scene of a campaign.

    Attributes:
        scenario: with the overrides.
        overrides: what the sweep changed.
        seed: of its runs.
        fingerprint: of the scenario.
    """

    scenario: Scenario
    overrides: Overrides
    seed: int
    fingerprint: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """A study, ready to run.

    Attributes:
        study: its keys, with the scenarios embedded.
        cases: scenarios times points of the sweep, in order.
    """

    study: Study
    cases: tuple[Case, ...]

    def to_yaml(self) -> str:
        """The study, whole in itself: it loads back to an equal plan."""
        return dump(self.study.model_dump(mode="json", exclude_none=True))


#: The options of the command line that change a key of the study.
OPTIONS = {
    "filters": "--filter",
    "runs": "--runs",
    "seed": "--seed",
    "time_limit_s": "--time-limit",
}


def load(
    path: Path | str, overrides: Sequence[str] = (), options: Mapping[str, Any] | None = None
) -> Plan:
    """Read a study, or a scenario as a study of one.

    Args:
        path: of either; files that it names are looked for beside it.
        overrides: `key.path=value`, each sets one value of every scenario, whatever the sweep says.
        options: keys of the study that are told otherwise than by the file, such as `runs`.

    Raises:
        ScenarioError: what is said is no study; holds every fault with its place.
    """
    path = Path(path)
    document = read(path)
    if isinstance(document.data, dict) and not _study_keys() & set(document.data):
        document = _study_of(document)
    if isinstance(document.data, dict):
        for key, value in (options or {}).items():
            put(document, (key,), value, OPTIONS.get(key, key))
        for override in overrides:
            _fix(document, override)
    study = validated(Study, document, {"name": name_of(path)}, {})
    return _plan(study, document, path)


def _known(resolver: Any, name: str) -> None:
    try:
        resolver(name)
    except InputError as error:
        raise fault("{error}", error=error) from error


def _study_keys() -> set[str]:
    return set(Study.__pydantic_fields__) - set(Scenario.__pydantic_fields__)


def _study_of(scene: Document) -> Document:
    """A study that holds a scene."""
    places = {("scenarios", 0, *location): place for location, place in scene.places.items()}
    return Document(scene.where, {"scenarios": [scene.data]}, places, scene.faults)


def _fix(document: Document, override: str) -> None:
    """Let every grid of the sweep have one value for a key."""
    place = f"--set {override}"
    key, equals, value = (part.strip() for part in override.partition("="))
    given = parse(value, place)
    if not equals or not all(key.split(".")):
        message = "expected key.path=value, as in --set camera.sigma_px=0.5"
        document.faults.append(Fault(place, "", message))
        return
    document.faults.extend(Fault(place, key, fault.message) for fault in given.faults)
    sweep = document.data.setdefault("sweep", {})
    for location, grid in _grids_of(sweep):
        if isinstance(grid, dict):
            grid[key] = [None if value == "" else given.data]
            document.places[(*location, key)] = place


def _grids_of(sweep: Any) -> Iterator[tuple[Location, Any]]:
    """The grids of a sweep as it is written, with their locations."""
    if isinstance(sweep, dict):
        yield ("sweep",), sweep
    elif isinstance(sweep, list):
        yield from ((("sweep", i), grid) for i, grid in enumerate(sweep))


def _plan(study: Study, document: Document, path: Path) -> Plan:
    """The cases of a study, with the faults of all of them at once."""
    scenes, cases, faults = [], [], list[Fault]()
    locations = [location for location, _ in _grids_of(document.data.get("sweep", {}))]
    for i, named in enumerate(study.scenarios):
        try:
            scene, base_dir, name = _scene(named, document, i, path)
            scenario = scenario_of(_copy(scene), base_dir, name)
            scenes.append(scenario.model_dump(mode="json", exclude_none=True))
        except ScenarioError as error:
            faults += error.faults
            continue
        for location, grid in zip(locations, study.sweep, strict=True):
            for values in product(*grid.values()):
                point = dict(zip(grid, values, strict=True))
                try:
                    cases.append(_case(scene, base_dir, name, _placed(point, location, document)))
                except ScenarioError as error:
                    faults += error.faults
    if faults:
        raise ScenarioError(tuple(dict.fromkeys(faults)))
    made = [
        Case(
            scenario=scenario,
            overrides=point,
            seed=scenario.seed if study.seed is None else study.seed,
            fingerprint=scenario.fingerprint(),
        )
        for scenario, point in cases
    ]
    _refuse_equal(made, document)
    return Plan(study=study.model_copy(update={"scenarios": tuple(scenes)}), cases=tuple(made))


#: The values of a point, each with where it was said.
_Placed = Mapping[str, tuple[Any, str]]


def _placed(point: Overrides, location: Location, document: Document) -> _Placed:
    return {key: (value, document.place((*location, key))) for key, value in point.items()}


def _scene(
    named: str | dict[str, Any], document: Document, i: int, path: Path
) -> tuple[Document, Path, str]:
    """A scenario of a study as plain data, where its files are, and its default name."""
    if isinstance(named, str):
        file = path.parent / named
        return read(file), file.parent, name_of(file)
    places = {
        location[2:]: place
        for location, place in document.places.items()
        if location[:2] == ("scenarios", i)
    }
    return Document(document.where, named, places), path.parent, name_of(path)


def _copy(document: Document) -> Document:
    faults = list(document.faults)
    return Document(document.where, deepcopy(document.data), dict(document.places), faults)


def _case(scene: Document, base_dir: Path, name: str, point: _Placed) -> tuple[Scenario, Overrides]:
    changed = _copy(scene)
    for key, (value, place) in point.items():
        put(changed, tuple(key.split(".")), deepcopy(value), place)
    values = {key: value for key, (value, _) in point.items()}
    return scenario_of(changed, base_dir, name), values


def _refuse_equal(cases: Sequence[Case], document: Document) -> None:
    """Refuse a case that is there twice: its rows could not be told apart."""
    seen: dict[str, Case] = {}
    for case in cases:
        if case.fingerprint in seen:
            message = (
                f"expected scenes that differ, got {case.scenario.name} with "
                f"{dict(case.overrides) or 'no change'} and with "
                f"{dict(seen[case.fingerprint].overrides) or 'no change'}, which are equal"
            )
            raise ScenarioError((Fault(document.place(("sweep",)), "sweep", message),))
        seen[case.fingerprint] = case
