"""What a user may tune in dense reconstruction."""

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class MatchingSettings(BaseModel):
    """Matching of one view against its neighbours: windows, sources, sweeps."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    cell_px: Literal[1, 2, 3, 4] = Field(2, description="side of the square of pixels that shares one estimate")
    window_px: int = Field(8, ge=4, le=16, description="side of the matching window, pixels of the level it is used at")
    sources: int = Field(4, ge=1, le=8, description="views that each view is matched with")
    best_sources: int = Field(2, ge=1, le=8, description="sources whose correlations are averaged while hypotheses compete")
    min_angle_deg: float = Field(5.0, gt=0, lt=90, description="smallest angle at the subject between a view and a source")
    max_angle_deg: float = Field(50.0, gt=0, lt=120, description="largest angle at the subject between a view and a source")
    coarsest_px: int = Field(120, ge=24, description="longer image side at the coarsest pyramid level")
    depth_planes: int = Field(64, ge=8, description="depths tried for every cell of the coarsest level, without a prior")
    coarse_sweeps: int = Field(4, ge=1, description="propagation sweeps at the coarsest level")
    level_sweeps: int = Field(2, ge=0, description="propagation sweeps one level above the finest; one more at each coarser")
    trials: int = Field(3, ge=0, description="random changes that each cell tries in a sweep")
    finest_views: int = Field(
        2, ge=1, description="views, of those that see a place best, that refine it at the finest level; others only vote"
    )
    smoothing_px: float = Field(0.6, ge=0, description="Gaussian blur of the photographs before they are sampled, pixels")
    min_contrast: float = Field(0.7, ge=0, description="least standard deviation of a window, grey levels of 255")
    max_cost: float = Field(0.75, gt=0, le=2, description="1 - correlation above which a cell is given up between levels")


class RefinementSettings(BaseModel):
    """Photometric Gauss-Newton refinement of depth and slopes, with a weak smoothness prior."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    sweeps: int = Field(2, ge=0, description="sweeps over all cells at the finest level")
    coarse_sweeps: int = Field(1, ge=0, description="sweeps over all cells at every coarser level")
    noise_grey: float = Field(
        6.0, gt=0, description="standard deviation of one sample, grey levels of 255, raised for the overlap of windows"
    )
    smoothness_px: float = Field(
        0.04, gt=0, description="expected departure of a neighbouring cell from the plane, pixels of disparity"
    )
    smoothness_slope: float = Field(0.04, gt=0, description="expected change of slope between cells, pixels per pixel")
    discontinuity_px: float = Field(0.7, gt=0, description="departure beyond which neighbours count as another surface, pixels")
    converged_px: float = Field(0.01, ge=0, description="a cell whose last step was smaller is left alone, pixels")


class FusionSettings(BaseModel):
    """Which estimates of several views agree, and how many points are kept."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    min_views: int = Field(2, ge=2, description="views that must agree on a point, its own included")
    max_disparity_px: float = Field(1.0, gt=0, description="disagreement in depth, pixels of disparity between the two views")
    max_normal_deg: float = Field(35.0, gt=0, le=180, description="largest angle between the normals of two views")
    max_viewing_deg: float = Field(78.0, gt=0, lt=90, description="a view that sees the surface more obliquely has no say")
    rim_cells: float = Field(
        1.5, ge=0, description="jump in depth, in cell widths, that makes a cell a rim: it makes no point; 0 keeps rims"
    )
    spacing_px: float = Field(
        1.2, ge=0, description="least distance of two points, in pixels of the rig's median view; 0 keeps all"
    )
    max_points: int = Field(200_000, ge=1000, description="spacing grows until no more points than this are left")
    box_m: tuple[tuple[float, float, float], tuple[float, float, float]] | None = Field(
        None, description="least and largest x, y, z of points in the world frame, metres"
    )
    outlier_reach_px: float = Field(
        4.0, gt=0, description="how far around a point, along its surface, others are counted, in pixels of the median view"
    )
    outlier_neighbours: int = Field(6, ge=0, description="points that must be there for a point to be kept; 0 keeps all")


class ReconstructSettings(BaseModel):
    """Dense multi-view stereo of one frame."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    engine: Literal["auto", "patchmatch", "colmap"] = Field(
        "auto", description="patchmatch: CPU; colmap: CUDA through pycolmap; auto: colmap where it has CUDA"
    )
    fusion_engine: Literal["headcap", "colmap"] = Field("headcap", description="who fuses depth maps to points")
    scale: float | None = Field(None, gt=0, le=1, description="photographs are shrunk by it; by default from most_pixels")
    most_pixels: int = Field(
        800_000, ge=10_000, description="larger photographs are shrunk to this many pixels: cells then suit max_points"
    )
    near_m: float | None = Field(None, gt=0, description="nearest depth searched; by default from the rig's geometry")
    far_m: float | None = Field(None, gt=0, description="farthest depth searched; by default from the rig's geometry")
    matching: MatchingSettings = Field(default_factory=MatchingSettings, description="matching of views")
    refinement: RefinementSettings = Field(default_factory=RefinementSettings, description="sub-pixel refinement")
    fusion: FusionSettings = Field(default_factory=FusionSettings, description="fusion to points")
    gpu_index: str = Field("0", description="CUDA device of the colmap engine")
