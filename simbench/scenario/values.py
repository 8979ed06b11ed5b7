"""The values that a scene is made of: numbers within bounds, points, ranges, one or several."""

from typing import Annotated, Any, TypeAlias, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Discriminator, Field, Tag
from pydantic_core import PydanticCustomError


class Section(BaseModel):
    """A mapping of the scene file: frozen, and no key that is not known."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)


def fault(message: str, key: str | None = None, **values: Any) -> PydanticCustomError:
    """An error in words that a user understands; `{name}` in the message stands for a value.

    Args:
        message: what was expected and what came.
        key: of the section that is being checked, where the whole section is not meant.
        values: for the message.
    """
    # The message is finished here: pydantic formats integers and text only, and wants a literal.
    text = message.format(**values)
    return PydanticCustomError("fault", "{text}", {"text": text, "key": key})


def _increasing(value: tuple[float, float]) -> tuple[float, float]:
    if not value[0] < value[1]:
        raise fault("expected the smaller number first, got {got}", got=list(value))
    return value


Number: TypeAlias = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive: TypeAlias = Annotated[Number, Field(gt=0)]
NonNegative: TypeAlias = Annotated[Number, Field(ge=0)]
Share: TypeAlias = Annotated[Number, Field(ge=0, le=1)]
Integer: TypeAlias = Annotated[int, Field(strict=True)]
Count: TypeAlias = Annotated[Integer, Field(ge=1, le=1_000_000)]
Text: TypeAlias = Annotated[str, Field(strict=True)]
Point: TypeAlias = tuple[Number, Number, Number]
Range: TypeAlias = Annotated[tuple[Number, Number], AfterValidator(_increasing)]

_One = TypeVar("_One")
_Many = TypeVar("_Many")
_Word = TypeVar("_Word")
_Value = TypeVar("_Value")

# The tags show in the location of pydantic's errors; `faults` takes what stands in <> out again.
OneOr: TypeAlias = Annotated[
    Annotated[_One, Tag("<one>")] | Annotated[_Many, Tag("<list>")],
    Discriminator(lambda value: "<list>" if isinstance(value, list | tuple) else "<one>"),
]
WordOr: TypeAlias = Annotated[
    Annotated[_Word, Tag("<word>")] | Annotated[_Value, Tag("<value>")],
    Discriminator(lambda value: "<word>" if isinstance(value, str) else "<value>"),
]
PerAxis: TypeAlias = OneOr[NonNegative, tuple[NonNegative, NonNegative, NonNegative]]
