"""Settings of the tracker."""

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from headcap.registration.correspondence import CorrespondenceSettings
from headcap.registration.flow import FlowSettings
from headcap.registration.graph import GraphSettings
from headcap.registration.keyframes import KeyframeSettings
from headcap.registration.photometric import PhotometricSettings
from headcap.registration.refine import RefineSettings


class LipSettings(BaseModel):
    """Surface flow on the mouth alone."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    reach_mm: float = Field(25.0, gt=0, description="Skin this near the lips, along the surface, belongs to the mouth")
    steps: int = Field(3, ge=0, description="Steps per frame in the coarse pass; 0 leaves the lips to the whole mesh")
    photometric: PhotometricSettings = Field(default_factory=PhotometricSettings)


class TrackSettings(BaseModel):
    """Template, photographs and clouds to a mesh sequence."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    reference: Literal["own_photograph", "texture"] = Field(
        "own_photograph",
        description="Texture of the rendering: each camera's own first photograph where it saw the surface, or the baked one",
    )
    edge_margin_px: int = Field(1, description="A first photograph is not used this near an occluding edge, pixels")
    coarse_width_px: int = Field(270, description="Images are reduced to about this width (shorter side) for the coarse pass")
    coarse_rounds: int = Field(2, description="Rounds of render, flow and graph per frame in the coarse pass")
    coarse_settled_mm: float = Field(
        0.8, description="A round that moves 99 % of the vertices less than this is the frame's last"
    )
    coarse_refinements: int = Field(1, description="Surface-flow steps after the graph in the coarse pass")
    fine_width_px: int = Field(
        540, description="Images wider than this (shorter side) are reduced to it for the fine pass; 0 never"
    )
    fine_refinements: int = Field(3, description="Surface-flow steps per frame in the fine pass")
    flow_robust_px: float = Field(
        1.0, description="Scale of the robust weight of flow targets at the coarse image's resolution, pixels"
    )
    time_gap_frames: float = Field(
        1.0, description="A camera without a photograph this near in time (in frame intervals) sits a frame out"
    )
    start_rounds: int = Field(
        4, description="Rounds of graph, then of refinement, that draw the template onto the first frame's points"
    )
    texture_size_px: int = Field(1024, description="Side of the baked texture")
    flow: FlowSettings = Field(default_factory=lambda: FlowSettings(window_px=11))
    correspondence: CorrespondenceSettings = Field(default_factory=CorrespondenceSettings)
    graph: GraphSettings = Field(default_factory=GraphSettings)
    coarse_photometric: PhotometricSettings = Field(default_factory=lambda: PhotometricSettings(window_px=11, robust_scale=3.0))
    photometric: PhotometricSettings = Field(default_factory=PhotometricSettings)
    lips: LipSettings = Field(default_factory=LipSettings)
    keyframes: KeyframeSettings = Field(default_factory=KeyframeSettings)
    refine: RefineSettings = Field(default_factory=RefineSettings)
