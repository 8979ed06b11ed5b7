"""From text to a scene, or to all that is wrong with it."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from simbench.errors import DatasetError, Fault, ScenarioError
from simbench.files import read_text
from simbench.scenario.faults import fault_of
from simbench.scenario.scene import Scenario
from simbench.scenario.text import Document, Location, key_of, parse

_Model = TypeVar("_Model", bound=BaseModel)

#: More help nobody, and to say what is meant by each takes time.
MAX_FAULTS = 100


def load(path: Path | str, overrides: Sequence[str] = ()) -> Scenario:
    """Read a scene file.

    Args:
        path: the file; files that it names are looked for beside it. Its stem is the default name.
        overrides: `key.path=value`, each sets one value, read as YAML.

    Raises:
        ScenarioError: the file cannot be read or is no scene; holds every fault with its place.
    """
    path = Path(path)
    document = read(path)
    for override in overrides:
        put_option(document, override)
    return scenario_of(document, path.parent, name_of(path))


def read(path: Path) -> Document:
    """The plain data of a YAML file.

    Raises:
        ScenarioError: the file cannot be read.
    """
    try:
        return parse(read_text(path), str(path))
    except DatasetError as error:
        message = str(error).removeprefix(f"{path}: ")
        raise ScenarioError((Fault(str(path), "", message),)) from error


def name_of(path: Path) -> str:
    """The default name of what a file describes: its stem, as far as a name may hold it."""
    return re.sub(r"[^\w.+-]", "_", path.stem.lstrip("._")) or "scene"


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
    document = parse(text, where)
    for override in overrides:
        put_option(document, override)
    return scenario_of(document, base_dir or Path(), "scene")


def scenario_of(document: Document, base_dir: Path, name: str) -> Scenario:
    """The scene of a document.

    Args:
        document: as read; values may have been put in since.
        base_dir: where files that it names are looked for.
        name: where the document has none.

    Raises:
        ScenarioError: as for `load`.
    """
    return validated(Scenario, document, {"name": name}, {"base_dir": base_dir})


def validated(
    model: type[_Model], document: Document, defaults: dict[str, Any], context: dict[str, Any]
) -> _Model:
    """A model of a document's data, or all that is wrong with them."""
    faults = document.faults
    if not isinstance(document.data, dict):
        if not faults:
            message = f"expected a mapping of sections, got {document.data!r:.60}"
            faults.append(Fault(document.place(()), "", message))
        raise ScenarioError(tuple(faults))
    try:
        found = model.model_validate(defaults | document.data, context=context)
    except ValidationError as error:
        shown = error.errors(include_url=False)[:MAX_FAULTS]
        faults += [fault_of(each, document, model) for each in shown]
    if len(faults) >= MAX_FAULTS:
        faults[MAX_FAULTS:] = [Fault(document.where, "", "and more; mend these first")]
    if faults:
        raise ScenarioError(tuple(faults))
    return found


def put_option(document: Document, override: str) -> None:
    """Set one value of a document to that of `--set`, or note what is wrong with the option."""
    if not isinstance(document.data, dict):
        return
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
    put(document, location, None if value.strip() == "" else given.data, place)


def put(document: Document, location: Location, value: Any, place: str) -> None:
    """Set one value of a document, or note that there is no section to hold it.

    Args:
        document: its data are a mapping.
        location: of the value.
        value: plain data.
        place: where it is said, for errors.
    """
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
    section[location[-1]] = value
    for old in [old for old in document.places if old[: len(location)] == location]:
        del document.places[old]
    document.places[location] = place
