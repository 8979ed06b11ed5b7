"""Files that a scene names: read at once and embedded, so that a scene is whole in itself."""

from pathlib import Path
from typing import Any

from pydantic import ValidationInfo, model_validator

from simbench.errors import DatasetError
from simbench.scenario.values import Section, Text, fault


class Named(Section):
    """What both `file` kinds share: `path` is read when the scene is, and kept as `text`."""

    kind: str
    path: Text | None = None
    text: Text = ""

    @classmethod
    def read(cls, path: Path) -> str:
        """The content of a file as `text` holds it; raises DatasetError."""
        raise NotImplementedError

    @model_validator(mode="before")
    @classmethod
    def _embed(cls, value: Any, info: ValidationInfo) -> Any:
        if not isinstance(value, dict):
            return value
        match value:
            case {"path": _, "text": _}:
                raise fault("expected path or text, got both", key="text")
            case {"path": None}:
                raise fault("expected the name of a file, got nothing", key="path")
            case {"path": str(path), **rest}:
                base = (info.context or {}).get("base_dir") or "."
                try:
                    return {**rest, "text": cls.read(Path(base, path))}
                except DatasetError as error:
                    raise fault("{error}", key="path", error=error) from error
            case {"path": _} | {"text": _}:
                return value
        raise fault("expected the name of a file, got nothing", key="path")
