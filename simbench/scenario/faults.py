"""What pydantic found, in words that a user of scene files understands."""

import difflib
from typing import Any, get_args

from pydantic import BaseModel
from pydantic_core import ErrorDetails

from simbench.errors import Fault
from simbench.scenario.scene import Scenario
from simbench.scenario.text import Document, Location, key_of

_EXPECTED = {
    "greater_than": "a number above {gt:g}",
    "greater_than_equal": "a number of at least {ge:g}",
    "less_than": "a number below {lt:g}",
    "less_than_equal": "a number of at most {le:g}",
    "finite_number": "a finite number",
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "bool_type": "true or false",
    "string_type": "text",
    "tuple_type": "a list",
    "too_short": "a list of at least {min_length}",
    "too_long": "a list of at most {max_length}",
    "literal_error": "{expected}",
    "model_type": "a mapping of keys",
    "model_attributes_type": "a mapping of keys",
    "string_pattern_mismatch": "letters, digits and _ . + -, beginning with a letter or a digit",
    "string_too_long": "at most {max_length} characters",
}


def fault_of(error: ErrorDetails, document: Document, model: type[BaseModel] = Scenario) -> Fault:
    """One error of pydantic as a fault, with the place in the document that is held for a model."""
    context: dict[str, Any] = error.get("ctx", {})
    location, models = _locate(error["loc"], model)
    match error["type"]:
        case "fault":
            message = context["text"]
            if context["key"] not in (None, *location[-1:]):
                location += (context["key"],)
        case "extra_forbidden":
            message = "unknown key; " + _known(str(location[-1]), models)
        case "union_tag_invalid":
            message = f"expected one of {context['expected_tags']}, got {context['tag']!r}"
            location += ("kind",)
        case "missing":
            message = f"expected another value, for this list is too short: {error['input']!r:.60}"
        case kind if kind in _EXPECTED:
            message = f"expected {_EXPECTED[kind].format(**context)}, got {_shown(error)}"
        case _:
            message = f"{error['msg']}, got {_shown(error)}"
    return Fault(document.place(location), key_of(location), message)


def _locate(loc: Location, model: type[BaseModel]) -> tuple[Location, list[type[BaseModel]]]:
    """An error's location without pydantic's tags, and the models that could hold its last key."""
    location: Location = ()
    models: list[type[BaseModel]] = [model]
    holders = models
    for part in loc:
        if isinstance(part, str) and part.startswith("<"):
            continue
        if location in (("trajectory",), ("landmarks",)) and len(models) > 1:
            models = [m for m in models if m.__pydantic_fields__["kind"].default == part]
            continue
        holders, location = models, (*location, part)
        fields = (model.__pydantic_fields__.get(str(part)) for model in models)
        models = [found for field in fields if field for found in _models(field.annotation)]
    return location, holders


def _models(annotation: Any) -> list[type[BaseModel]]:
    """The models within a type."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models(part)]


def _known(key: str, models: list[type[BaseModel]]) -> str:
    """What could be meant by a key that is not known."""
    keys = [known for model in models for known in model.__pydantic_fields__]
    begin = [known for known in keys if known.startswith(key)]
    if close := begin or difflib.get_close_matches(key, keys, 1):
        return f"did you mean {close[0]}?"
    return "expected one of " + ", ".join(keys)


def _shown(error: ErrorDetails) -> str:
    """What came, short."""
    value = error["input"]
    if error["type"] in ("too_short", "too_long") and isinstance(value, list | tuple):
        return f"{len(value)}"
    if value is None:
        return "nothing; leave the key out for its default"
    if isinstance(value, dict):
        return "a mapping"
    return repr(value) if len(repr(value)) <= 60 else f"{repr(value)[:57]}..."
