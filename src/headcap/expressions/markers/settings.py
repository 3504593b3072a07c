"""What counts as a gap, as rigid, as tied, in a marker recording."""

from pydantic import BaseModel, ConfigDict, Field


class MarkerSettings(BaseModel):
    """Cleaning of markers and their interpolation over the face."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    longest_gap_s: float = Field(0.25, ge=0, description="Gaps up to this long are filled, longer ones refused")
    neighbours: int = Field(8, ge=1, description="Markers nearest at rest from which a missing one's motion is foretold")
    ridge: float = Field(
        1e-3, gt=0, description="Share of the neighbours' own variance that damps what is foretold from them, against noise"
    )
    rigid_tolerance_mm: float = Field(
        0.5,
        gt=0,
        description="Distances between rigid markers vary by less (standard deviation) where the rigid set is looked for; a "
        "named rigid marker may lie off the common motion by three times as much",
    )
    farthest_tie_mm: float = Field(15.0, gt=0, description="A marker may stand so far off the neutral mesh")
    reach_mm: float = Field(
        30.0, gt=0, description="Without a region of the face, skin this near to a marker moves in full; beyond it motion fades"
    )
    fade_mm: float = Field(40.0, ge=0, description="Skin over which displacements fade to none beyond that, or beyond the region")
