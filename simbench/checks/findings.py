"""What an exact audit finds."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

#: Deviations below this are rounding: 1e-14 m far from the origin, over eps = 1e-4 times 1 mm.
ROUNDING = 1e-7


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """Where a filter's claim first parts from the truth.

    Attributes:
        call: such as "predict 2", numbered by the frame that it starts from or takes in.
        block: which part of the covariance, "innovation covariance", "innovation whiteness",
            "estimate" (wrong even without noise) or "exception".
        claimed, true: the element that differs most, as the filter has it and as it is.
        deviation: their difference over the two standard deviations.
        reason: in words, where numbers do not say it.
    """

    call: str
    block: str
    claimed: float | None = None
    true: float | None = None
    deviation: float | None = None
    reason: str = ""

    def __str__(self) -> str:
        if self.reason:
            return f"{self.call} {self.reason}"
        return f"{self.call}: {self.block}, claimed {self.claimed:.4g}, true {self.true:.4g}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Deviations:
    """By how much claim and truth differ at one eps, the worst over all calls.

    Attributes:
        eps: scale of the realised noise.
        block: elements of the covariance, over two standard deviations: the judge.
        pose_nees, joint_nees: mean NEES over eps^2, minus its degrees of freedom; None where the
            filter has no such covariance.
        nis: mean NIS over eps^2 and its degrees of freedom, minus 1.
        whiteness: mean products of whitened innovations of different updates, over eps^2.
    """

    eps: float
    block: float
    pose_nees: float | None
    joint_nees: float | None
    nis: float | None
    whiteness: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneAudit:
    """The audit of a filter on one scene.

    Attributes:
        scene: its name.
        first: the first deviation that does not vanish with eps, None where there is none.
        deviations: one for each eps, the largest eps first; empty where the filter raised.
        scalars: of noise in the scene.
    """

    scene: str
    first: Finding | None
    deviations: tuple[Deviations, ...]
    scalars: int

    def __str__(self) -> str:
        if self.first is not None:
            return str(self.first)
        text = f"no deviation in {self.scalars} scalars of noise"
        if (noise := self.noise_at_ten_percent) is not None:
            text += f"; nonlinearity reaches 10 % at {noise:.2g} times this scene's noise"
        return text

    @property
    def passed(self) -> bool:
        """Whether every deviation vanishes with eps."""
        return self.first is None

    @property
    def order(self) -> float | None:
        """The power of eps with which the block deviation falls; 2 for a right filter.

        None where nothing but rounding is left at the smaller eps.
        """
        if not self.deviations:
            return None
        a, b = self.deviations[:2]
        if b.block < ROUNDING:
            return None
        return float(np.log(a.block / b.block) / np.log(a.eps / b.eps))

    @property
    def noise_at_ten_percent(self) -> float | None:
        """At how many times the scene's noise the deviation of a block reaches 10 %.

        Below 1 the scene is outside the linear regime, where no EKF's covariance can be trusted.
        """
        if not self.deviations or not self.deviations[0].block:
            return None
        return float(self.deviations[0].eps * np.sqrt(0.1 / self.deviations[0].block))


@dataclass(frozen=True, slots=True, kw_only=True)
class AuditResult:
    """The audit of a filter on several scenes."""

    scenes: tuple[SceneAudit, ...]

    @property
    def passed(self) -> bool:
        """Whether the filter passed on each."""
        return all(scene.passed for scene in self.scenes)

    @property
    def first(self) -> Finding | None:
        """What was found on the first scene that it did not pass."""
        return next((scene.first for scene in self.scenes if scene.first is not None), None)

    def as_json(self) -> dict[str, Any]:
        """JSON-safe; `deviations` are the worst of all scenes, by eps."""
        names = ("block", "pose_nees", "joint_nees", "nis", "whiteness")
        worst: dict[str, dict[str, float | None]] = {}
        for one in (d for scene in self.scenes for d in scene.deviations):
            at = worst.setdefault(f"{one.eps:g}", dict.fromkeys(names))
            for name in names:
                found = [v for v in (at[name], getattr(one, name)) if v is not None]
                at[name] = max(found, key=abs, default=None)
        return {
            "passed": self.passed,
            "first": None if self.first is None else asdict(self.first),
            "deviations": worst,
            "scenes": [
                {
                    "name": scene.scene,
                    "passed": scene.passed,
                    "first": None if scene.first is None else asdict(scene.first),
                    "scalars": scene.scalars,
                    "order": scene.order,
                    "noise_at_ten_percent": scene.noise_at_ten_percent,
                }
                for scene in self.scenes
            ],
        }
