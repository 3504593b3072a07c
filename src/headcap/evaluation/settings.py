"""What `evaluate` samples, and the limits its figures are held to."""

from __future__ import annotations

from collections.abc import Mapping

from pydantic import BaseModel, ConfigDict, Field, field_validator

from headcap.evaluation.catalogue import CATALOGUE, limit_factor


class EvaluateSettings(BaseModel):
    """Sampling of the evaluation; limits of figures."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    limits: dict[str, float | None] = Field(
        default_factory=dict,
        description="Limits by figure name, in the figure's unit, in place of the default ones and as they stand, whatever the "
        "resolution; null lifts a limit.",
    )
    cloud_frames: int = Field(
        default=8, ge=1, description="Point clouds compared per take, evenly spread from the first to the last."
    )
    surface_samples: int = Field(
        default=100_000, ge=1_000, description="Points spread evenly by area over the true surface, for completeness."
    )
    max_angle_deg: float = Field(
        default=75.0, gt=0, le=90, description="A camera sees a surface point up to this angle between normal and line of sight."
    )
    min_cameras: int = Field(default=3, ge=1, description="Cameras that must see a surface point for it to count.")

    @field_validator("limits")
    @classmethod
    def _known(cls, limits: dict[str, float | None]) -> dict[str, float | None]:
        unknown = sorted(set(limits) - set(CATALOGUE))
        if unknown:
            raise ValueError(f"no figure is called {', '.join(unknown)}; known are {', '.join(sorted(CATALOGUE))}")
        return limits

    def limit(self, name: str) -> float | None:
        """The limit in force for a figure, or None where it is only stated."""
        if name in self.limits:
            return self.limits[name]
        return CATALOGUE[name].limit if name in CATALOGUE else None

    def with_limits(self, limits: Mapping[str, float | None]) -> EvaluateSettings:
        """The same with some limits of its own; raises `ValidationError` for a figure that nobody knows."""
        return EvaluateSettings.model_validate(self.model_dump() | {"limits": self.limits | dict(limits)})

    def at_pixel(self, pixel_mm: float | None) -> EvaluateSettings:
        """The same with default limits as a rig of this pixel on the skin is held to; limits set here stay as they are."""
        factor = limit_factor(pixel_mm)
        scaled = {name: factor * kind.limit for name, kind in CATALOGUE.items() if kind.by_pixel and kind.limit is not None}
        return self.model_copy(update={"limits": scaled | self.limits})
