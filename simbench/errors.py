"""What can go wrong, and whose affair it is.

SimbenchError
├── InputError        what a user gave is not usable (exit status 2)
│   ├── ScenarioError   a scene file; carries every fault at once
│   └── DatasetError    a dataset, a recording or a trajectory
├── OutputError       a result cannot be written (exit status 2)
└── FilterFailure     the filter under test raised or returned nonsense: a result
"""

from dataclasses import dataclass


class SimbenchError(Exception):
    """The root of the tree."""


class InputError(SimbenchError):
    """What a user gave is not usable: what was expected, what came, what to do."""


class DatasetError(InputError):
    """A dataset, a recording or a trajectory that is not usable."""


class OutputError(SimbenchError):
    """A result cannot be written."""


class FilterFailure(SimbenchError):
    """The filter under test raised, or returned what is no belief: `call` and `reason` say it."""

    def __init__(self, call: str, reason: str) -> None:
        """The message is the call, such as "update 2", and the reason behind it."""
        super().__init__(f"{call} {reason}")
        self.call, self.reason = call, reason


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault of a scene file.

    Attributes:
        where: file and line, or the option that set the value.
        key: the dotted path of the key.
        message: what was expected and what came.
    """

    where: str
    key: str
    message: str

    def __str__(self) -> str:
        return (
            f"{self.where}: {self.key}: {self.message}"
            if self.key
            else f"{self.where}: {self.message}"
        )


class ScenarioError(InputError):
    """A scene that is not valid; `faults` holds all that is wrong with it."""

    def __init__(self, faults: tuple[Fault, ...]) -> None:
        """Join the faults into one message, a line each."""
        super().__init__("\n".join(map(str, faults)))
        self.faults = faults
