"""From text to a scene, or to all that is wrong with it."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from simbench.errors import DatasetError, Fault, ScenarioError
from simbench.files import read_text
from simbench.scenario.faults import fault_of
from simbench.scenario.scene import Scenario
from simbench.scenario.text import Document, Location, key_of, parse


def load(path: Path | str, overrides: Sequence[str] = ()) -> Scenario:
    """Read a scene file.

    Args:
        path: the file; files that it names are looked for beside it. Its stem is the default name.
        overrides: `key.path=value`, each sets one value, read as YAML.

    Raises:
        ScenarioError: the file cannot be read or is no scene; holds every fault with its place.
    """
    path = Path(path)
    try:
        text = read_text(path)
    except DatasetError as error:
        message = str(error).removeprefix(f"{path}: ")
        raise ScenarioError((Fault(str(path), "", message),)) from error
    document = parse(text, str(path))
    name = re.sub(r"[^\w.+-]", "_", path.stem.lstrip("._"))
    return _validate(document, path.parent, overrides, name or "scene")


def loads(
    text: str,
    where: str = "<text>",
    base_dir: Path | None = None,
    overrides: Sequence[str] = (),
) -> Scenario:
    """Read a scene from text.

    Args:
        text: YAML.
        where: what the text is called in errors.
        base_dir: where files that it names are looked for; default: the working directory.
        overrides: as for `load`.

    Raises:
        ScenarioError: as for `load`.
    """
    return _validate(parse(text, where), base_dir or Path(), overrides, "scene")


def _validate(document: Document, base_dir: Path, overrides: Sequence[str], name: str) -> Scenario:
    """The scene of a document."""
    faults = document.faults
    if not isinstance(document.data, dict) and not faults:
        message = f"expected a mapping of sections, got {document.data!r:.60}"
        faults.append(Fault(document.place(()), "", message))
    if not isinstance(document.data, dict):
        raise ScenarioError(tuple(faults))
    for override in overrides:
        _override(document, override)
    try:
        scenario = Scenario.model_validate(
            {"name": name} | document.data, context={"base_dir": base_dir}
        )
    except ValidationError as error:
        faults += [fault_of(found, document) for found in error.errors(include_url=False)]
    if faults:
        raise ScenarioError(tuple(faults))
    return scenario


def _override(document: Document, override: str) -> None:
    """Set one value of a document, or note what is wrong with the option."""
    place = f"--set {override}"
    path, equals, value = override.partition("=")
    location: Location = tuple(path.strip().split("."))
    if not equals or not all(location):
        message = "expected key.path=value, as in --set camera.sigma_px=0.5"
        document.faults.append(Fault(place, "", message))
        return
    given = parse(value, place)
    if given.faults:
        faults = (Fault(place, path, fault.message) for fault in given.faults)
        document.faults.extend(faults)
        return
    section: Any = document.data
    for depth, key in enumerate(location[:-1], 1):
        if key not in section:
            section[key] = {}
            document.places[location[:depth]] = place
        section = section[key]
        if not isinstance(section, dict):
            message = f"expected a section above it, but {key} is {section!r:.40}"
            document.faults.append(Fault(place, key_of(location), message))
            return
    section[location[-1]] = None if value.strip() == "" else given.data
    for old in [old for old in document.places if old[: len(location)] == location]:
        del document.places[old]
    document.places[location] = place
