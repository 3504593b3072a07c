"""Settings of the lip contour detector and of its search."""

from pydantic import BaseModel, ConfigDict, Field


class BoostingSettings(BaseModel):
    """How boosted trees are grown."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    trees: int = Field(60, ge=1, description="Trees of a detector")
    depth: int = Field(5, ge=1, le=8, description="Questions from a tree's root to a leaf")
    learning_rate: float = Field(0.15, gt=0, le=1, description="Share of each tree's answer that counts")
    ridge: float = Field(1.0, ge=0, description="Of leaves' values, against the sum of their samples' curvature")
    least_curvature: float = Field(5.0, ge=0, description="Sum of a leaf's samples' curvature below which it is not split off")
    row_share: float = Field(0.5, gt=0, le=1, description="Samples that each tree sees")
    feature_share: float = Field(0.5, gt=0, le=1, description="Features that each tree may ask for")


class AugmentationSettings(BaseModel):
    """How training pictures are varied: a detector is used under lights, on skins and by cameras that it was not trained on."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    copies: int = Field(3, ge=1, description="Variations of each training picture")
    strength: float = Field(
        1.0,
        ge=0,
        description="Most of all variation of colour, light and sharpness; 0 takes pictures as they are. Trained on seven "
        "rehearsed people, contours of others err by 0.44 (outer) and 0.57 px (inner) without variation, 0.52 and 0.66 px with "
        "it; but of clips of four real people at a third of the resolution 64 to 88 % of the frames are found without it and "
        "80 to 100 % with it, and the share of the inner contour that looks like one rises from 0.49 to 0.76 to 0.91 to 0.95",
    )
    shift_mm: float = Field(3.0, ge=0, description="Standard deviation of the window's place")
    turn_deg: float = Field(5.0, ge=0, description="Of its turn")
    size_share: float = Field(0.07, ge=0, description="Of its size")


class ContourSettings(BaseModel):
    """What a detector looks at; figures in millimetres are on a head whose eyes are 63 mm apart."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    eye_distance_px: float = Field(
        112.0,
        gt=16,
        description="Distance of the eyes' middles at which the fine pass sees the mouth; half of it for the coarse one",
    )
    margin_mm: float = Field(16.0, gt=0, description="How far about the base tracker's mouth contours may lie")
    features: int = Field(300, ge=40, description="Features to choose from, drawn once")
    patch_px: int = Field(12, ge=4, description="Half the side of the patch a feature may look at, at either resolution")
    tolerance_px: float = Field(0.75, gt=0, description="Pixels so near a contour show it")
    clearance_px: float = Field(2.0, gt=0, description="Pixels so far from it do not; between the two nothing is said")
    samples: int = Field(50, ge=10, description="Pixels on a contour taken of each training picture; three times as many beside")
    boosting: BoostingSettings = BoostingSettings()
    augmentation: AugmentationSettings = AugmentationSettings()
    seed: int = Field(0, ge=0, description="Of all that is drawn")


class SearchSettings(BaseModel):
    """How contours are searched in likelihood maps (lip paper, section 5.1)."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    coarse_log_odds: float = Field(-2.5, description="Pixels to which the coarse pass gives less are not looked at again")
    reach_mm: float = Field(9.0, gt=0, description="How far the mouth as a whole may lie from the base tracker's")
    coarse_reach_mm: float = Field(
        5.0, gt=0, description="How far from there, along normals, the outer contour is searched first"
    )
    fine_reach_mm: float = Field(2.5, gt=0, description="The same about what the coarse pass found, in the fine one")
    places: int = Field(72, ge=16, multiple_of=2, description="Places round the outer contour")
    stations: int = Field(41, ge=9, description="Places across the inner contour")
    stiffness: float = Field(
        0.6,
        ge=0,
        description="Log-odds that a step of one pixel between neighbours on the outer contour costs. On rehearsed people left "
        "out, 0.1, 0.25, 0.6, 1.5 give 90th percentiles of 1.31, 1.30, 0.80, 0.81 px",
    )
    rim_stiffness: float = Field(
        0.25,
        ge=0,
        description="The same across the inner contour; there 0.1, 0.25, 0.5 give medians of 0.85, 0.83, 0.81 px",
    )
    least_share: float = Field(
        0.5, ge=0, le=1, description="Share of either lip's contour that must look like one, or it is not found"
    )
