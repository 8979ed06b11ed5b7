"""The YAML of a scene file: to plain data with the line of every value, and back.

The values are those of YAML 1.2 (`1e-4` is a number, `no` is text). Equal keys in one mapping,
aliases and tags are refused.
"""

import re
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import yaml

from simbench.errors import Fault

#: The path of a value: keys and list indices from the top.
Location: TypeAlias = tuple[str | int, ...]

MAX_NODES = 100_000
MAX_DEPTH = 20
MAX_KEY_LENGTH = 100

_TAG = "tag:yaml.org,2002:"
_SCALARS = {
    "null": (r"~|null|Null|NULL|", ["~", "n", "N", ""]),
    "bool": (r"true|True|TRUE|false|False|FALSE", list("tTfF")),
    "int": (r"[-+]?[0-9]+", list("-+0123456789")),
    "float": (
        r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?"
        r"|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)",
        list("-+0123456789."),
    ),
}

_SafeLoader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_SafeDumper: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)


# Both bases are Any, for which of the two there is depends on how yaml was built.
class _Loader(_SafeLoader):  # type: ignore[misc]
    yaml_implicit_resolvers: dict[str, Any] = {}  # noqa: RUF012


class _Dumper(_SafeDumper):  # type: ignore[misc]
    yaml_implicit_resolvers: dict[str, Any] = {}  # noqa: RUF012

    def ignore_aliases(self, data: object) -> bool:  # noqa: ARG002
        return True


for _name, (_pattern, _first) in _SCALARS.items():
    for _class in (_Loader, _Dumper):
        _class.add_implicit_resolver(_TAG + _name, re.compile(rf"^(?:{_pattern})$"), _first)


def _represent_text(dumper: Any, value: str) -> Any:
    style = "|" if "\n" in value else None
    return dumper.represent_scalar(_TAG + "str", value, style=style)


_Dumper.add_representer(str, _represent_text)


def dump(data: dict[str, Any]) -> str:
    """Plain data as YAML; equal data give equal text."""
    text: str = yaml.dump(
        data,
        Dumper=_Dumper,
        sort_keys=False,
        allow_unicode=True,
        default_flow_style=None,
        width=100,
    )
    return text


@dataclass(slots=True)
class Document:
    """A scene file as plain data.

    Attributes:
        data: the mapping.
        places: where the value at a location was set: file and line, or the option.
        faults: what is wrong with the YAML itself.
    """

    where: str
    data: Any = None
    places: dict[Location, str] = field(default_factory=dict)
    faults: list[Fault] = field(default_factory=list)

    def place(self, location: Location) -> str:
        """Where a value, or else the nearest one that holds it, was set."""
        while location and location not in self.places:
            location = location[:-1]
        return self.places.get(location, self.where)


def parse(text: str, where: str) -> Document:
    """Read YAML.

    Args:
        text: the YAML.
        where: the file's name, for errors.
    """
    document = Document(where)
    try:
        _bound(text)
        node = yaml.compose(text, Loader=_Loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f":{mark.line + 1}" if mark else ""
        said = ", ".join(filter(None, (error.context, error.problem)))
        document.faults.append(Fault(where + line, "", f"expected YAML: {said}"))
    except yaml.YAMLError as error:
        said = " ".join(str(error).split())
        document.faults.append(Fault(where, "", f"expected YAML: {said}"))
    else:
        document.data = {} if node is None else _construct(node, (), document)
    return document


def _bound(text: str) -> None:
    """Refuse what would take long or go deep, before it is built."""
    if (directive := re.search(r"^%", text, re.MULTILINE)) is not None:
        line = text.count("\n", 0, directive.start())  # of many, libyaml compares each with each
        mark: Any = yaml.Mark("", 0, line, 0, None, 0)
        raise yaml.MarkedYAMLError(
            problem="a line that begins with % is not allowed, scenes need no directive",
            problem_mark=mark,
        )
    depth = 0
    for count, event in enumerate(yaml.parse(text, Loader=_Loader)):
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        mark = event.start_mark
        if isinstance(event, yaml.AliasEvent):
            raise yaml.MarkedYAMLError(
                problem=f"the alias *{event.anchor} is not allowed, write the value out",
                problem_mark=mark,
            )
        if count > MAX_NODES:
            raise yaml.MarkedYAMLError(
                problem=f"more than {MAX_NODES} values; put long lists into a file that the scene "
                "names",
                problem_mark=mark,
            )
        if depth > MAX_DEPTH:
            raise yaml.MarkedYAMLError(problem=f"nested deeper than {MAX_DEPTH}", problem_mark=mark)


def _construct(node: yaml.Node, location: Location, document: Document) -> Any:
    """The value of a node; notes its line, and what is wrong with it."""
    place = document.places[location] = f"{document.where}:{node.start_mark.line + 1}"
    if isinstance(node, yaml.SequenceNode) and node.tag == _TAG + "seq":
        return [_construct(item, (*location, i), document) for i, item in enumerate(node.value)]
    if isinstance(node, yaml.MappingNode) and node.tag == _TAG + "map":
        mapping: dict[str, Any] = {}
        for key_node, value_node in node.value:
            line = key_node.start_mark.line + 1
            key = key_node.value if isinstance(key_node, yaml.ScalarNode) else None
            if isinstance(key, str) and len(key) > MAX_KEY_LENGTH:
                fault = f"expected a key, got a text of {len(key)} characters"
                document.faults.append(Fault(f"{document.where}:{line}", key_of(location), fault))
                continue
            if not isinstance(key, str):
                fault = "expected a word as key, got a list or a mapping"
                document.faults.append(Fault(f"{document.where}:{line}", key_of(location), fault))
                continue
            if key in mapping:
                fault = f"given twice, first at {document.places[(*location, key)]}; keep one"
                document.faults.append(
                    Fault(f"{document.where}:{line}", key_of((*location, key)), fault)
                )
                continue
            mapping[key] = _construct(value_node, (*location, key), document)
            document.places[(*location, key)] = f"{document.where}:{line}"
        return mapping
    if isinstance(node, yaml.ScalarNode):
        try:
            return _scalar(node.tag.removeprefix(_TAG), node.value)
        except ValueError:
            pass
    fault = f"expected plain YAML, got the tag {node.tag.replace(_TAG, '!!')} on {node.value!r:.40}"
    document.faults.append(Fault(place, key_of(location), fault))
    return None


def _scalar(kind: str, text: str) -> Any:
    """The value of a scalar; raises ValueError where the text is not of that kind."""
    match kind:
        case "str":
            return text
        case "null":
            return None
        case "bool":
            return text.lower() == "true"
        case "int":
            return int(text)
        case "float":
            return float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))
    raise ValueError(kind)


def key_of(location: Location) -> str:
    """A location as users write it: `rig.depth_m[1]`."""
    parts = (f"[{part}]" if isinstance(part, int) else f".{part}" for part in location)
    return "".join(parts).removeprefix(".")
