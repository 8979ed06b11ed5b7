"""The scene, whole."""

import hashlib
from typing import Annotated, Any

import numpy as np
from pydantic import Field, ValidationInfo, field_validator, model_validator

from simbench.scenario.landmarks import AlongPath, LandmarkKind
from simbench.scenario.sensors import Camera, Filter, Imu, PointSensor, Prior, Rig, Told
from simbench.scenario.text import dump
from simbench.scenario.trajectories import Figure8, TrajectoryKind
from simbench.scenario.values import Integer, Number, Positive, Section, Text, fault

MAX_FRAMES = 1_000_000


class Scenario(Section):
    """One scene: with a run number it determines every byte that is simulated."""

    name: Annotated[Text, Field(pattern=r"^\w[\w.+-]*$", max_length=80)] = "scene"
    """Names the files; the default is the file's stem."""
    about: Text = ""
    """One sentence on what the scene is for."""
    seed: Annotated[Integer, Field(ge=0, lt=2**63)] = 0
    duration_s: Positive = 40.0
    """Default: 40, or where waypoints with times, or a trajectory file, end."""
    rate_hz: Annotated[Positive, Field(le=10_000, validate_default=True)] = 10.0
    """Frames; the twist samples share their times."""
    time_jitter: Annotated[Number, Field(ge=0, lt=0.9)] = 0.0
    """Share of the period, uniform."""
    trajectory: TrajectoryKind = Figure8()
    landmarks: LandmarkKind = AlongPath()
    rig: Rig = Rig()
    imu: Imu = Imu()
    camera: Camera = Camera()
    point: PointSensor | None = None
    """A point sensor in place of the stereo pair."""
    prior: Prior = Prior()
    told: Told = Told()
    filter: Filter = Filter()

    @field_validator("trajectory", "landmarks", mode="before")
    @classmethod
    def _default_kind(cls, value: Any, info: ValidationInfo) -> Any:
        kind = {"trajectory": "figure8", "landmarks": "path"}[str(info.field_name)]
        return {"kind": kind, **value} if isinstance(value, dict) else value

    @field_validator("rate_hz")
    @classmethod
    def _enough_frames(cls, value: float, info: ValidationInfo) -> float:
        if (duration_s := info.data.get("duration_s")) is not None:
            _check_frames(duration_s, value)
        return value

    @model_validator(mode="after")
    def _ends_with_its_trajectory(self) -> "Scenario":
        end_s = self.trajectory.end_s(self.rate_hz)
        if end_s is None:
            return self
        if "duration_s" not in self.model_fields_set:
            _check_frames(end_s, self.rate_hz)
            object.__setattr__(self, "duration_s", end_s)  # frozen from here on
        elif self.duration_s > end_s + 1 / self.rate_hz:
            raise fault(
                "expected at most {end}, where the trajectory ends, got {got}",
                key="duration_s",
                end=end_s,
                got=self.duration_s,
            )
        return self

    @model_validator(mode="after")
    def _uses_what_it_says(self) -> "Scenario":
        relative = self.filter.process_noise == "twist-relative"
        for name, section in (
            ("velocity", self.imu.velocity),
            ("angular_velocity", self.imu.angular_velocity),
        ):
            if np.any(section.share) and not relative:
                raise fault(
                    "expected filter.process_noise: twist-relative beside a share, got {got}",
                    key=f"imu.{name}.share",
                    got=self.filter.process_noise,
                )
        if self.point is None:
            return self
        for key, of_stereo in (
            ("camera.half_missing", self.camera.half_missing > 0),
            ("camera.outliers", self.camera.outliers.share > 0),
            ("told.baseline_scale", self.told.baseline_scale != 1),
        ):
            if of_stereo:
                raise fault("goes with a stereo pair, but the scene has a point sensor", key=key)
        return self

    def to_yaml(self) -> str:
        """The scene as text, whole in itself: equal scenes give equal text, and it loads back."""
        return dump(self.model_dump(mode="json", exclude_none=True))

    def fingerprint(self) -> str:
        """Twelve hex digits that equal scenes share."""
        return hashlib.sha256(self.to_yaml().encode()).hexdigest()[:12]

    @classmethod
    def json_schema(cls) -> dict[str, Any]:
        """The JSON schema of a scene file, for editors."""
        return cls.model_json_schema()


def _check_frames(duration_s: float, rate_hz: float) -> None:
    """Refuse less than two frames, and more than anyone wants."""
    if not 1 <= (intervals := duration_s * rate_hz) < MAX_FRAMES:
        raise fault(
            "expected 1 to {most} intervals between frames, got duration_s times rate_hz = {got:g}",
            key="rate_hz",
            most=MAX_FRAMES,
            got=intervals,
        )
