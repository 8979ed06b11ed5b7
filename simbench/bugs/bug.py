"""What a bug of the catalogue is."""

from dataclasses import asdict, dataclass
from typing import Any

#: What may catch a bug: the exact audit, the structural checks, and those that need many runs.
CHECKS = (
    "audit",
    "null-space",
    "jacobian",
    "retraction",
    "masking",
    "covariance-laws",
    "nees",
    "landmark-nees",
    "nis",
    "whiteness",
    "nis-vs-dt",
    "raises",
    "gate-rate",
    "ate",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Trace:
    """What the audit names first.

    Attributes:
        scene: the first of `simbench.checks.scenes` on which the bug shows.
        call, block: as in `simbench.checks.audit.Finding`.
    """

    scene: str
    call: str
    block: str

    def __str__(self) -> str:
        return f"{self.call}: {self.block}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Bug:
    """A mistake, as a change of a filter that is right without it.

    Attributes:
        what: the mistake, in a sentence.
        source: where it was made.
        make: `module:function` of (task, parts), which makes the filter of these parts with the bug
            in it.
        base: the filter on which the clean form passes the checks that must catch it.
        checks: those of `CHECKS` that must catch it; none of a control.
        audit: what the audit names first; None where it is blind.
        blind: why the audit is blind.
    """

    what: str
    source: str
    make: str
    base: str = "slam"
    checks: tuple[str, ...]
    audit: Trace | None = None
    blind: str = ""

    @property
    def control(self) -> bool:
        """Whether it changes nothing that matters, so that no check may catch it."""
        return not self.checks

    def as_json(self) -> dict[str, Any]:
        """JSON-safe."""
        return asdict(self) | {"control": self.control, "checks": list(self.checks)}
