"""What can be tuned in calibration; defaults are lengths, times and ratios that hold for head rigs in general."""

from pydantic import BaseModel, ConfigDict, Field


class _Frozen(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class DetectSettings(_Frozen):
    """How densely a board recording is searched."""

    interval_s: float = Field(0.05, gt=0, description="time between searched frames; every frame where the rate is lower")
    full_search_px: int = Field(1280, ge=320, description="images longer than this are searched at reduced size, then refined")
    min_corners: int = Field(6, ge=4, description="a frame with fewer corners is dropped")
    max_uneven_px: float = Field(0.15, gt=0, description="a still frame lies this near the middle of the frames around it")
    max_frames: int = Field(1500, ge=10, description="searched frames per camera; the interval grows to keep to it")


class GroupSettings(_Frozen):
    """How detections of all cameras at nearly one moment become one board pose."""

    window_s: float = Field(0.03, gt=0, description="detections up to this far from a pose's moment can serve it")
    max_speed_px_s: float = Field(150.0, gt=0, description="frames in which corners move faster are left out")
    max_shift_px: float = Field(1.5, gt=0, description="largest correction of corners for the time to the pose's moment")
    min_cameras: int = Field(2, ge=1, description="cameras that must see a pose")
    max_poses: int = Field(80, ge=6, description="poses used; those that cover images best are preferred")


class RigSettings(_Frozen):
    """The bundle adjustment."""

    loss_px: float = Field(0.5, gt=0, description="scale of the Cauchy loss")
    outlier_sigmas: float = Field(6.0, gt=2, description="corners beyond this many robust standard deviations are left out")
    outlier_floor_px: float = Field(0.5, gt=0, description="corners nearer than this are never outliers")
    rounds: int = Field(3, ge=1, description="adjustments, each followed by rejection of outliers")
    max_iterations: int = Field(100, ge=5, description="of one adjustment")
    heldout_share: float = Field(0.2, gt=0, lt=0.6, description="poses left out to measure the error")
    bend_coverage: float = Field(0.3, ge=0, le=1, description="least coverage at which lenses and poses are adjusted together")
    keep_known_intrinsics: bool = Field(True, description="intrinsics given in the session stay as they are")


class CalibrateLimits(_Frozen):
    """Quality gates; a figure beyond its limit fails the stage unless the session allows it by name."""

    heldout_rms_px: float = Field(0.6, gt=0, description="per camera, reprojection in poses left out")
    heldout_p95_px: float = Field(1.5, gt=0, description="per camera")
    board_scale_error_mm: float = Field(1.0, gt=0, description="distances between triangulated held-out corners")
    coverage: float = Field(0.25, ge=0, le=1, description="per camera, least share of the image in which corners were seen")
    poses: int = Field(6, ge=3, description="per camera, least number of board poses")


class TimingSettings(_Frozen):
    """Camera time offsets from the moving board."""

    knot_s: float = Field(0.007, gt=0, description="finest knot interval of the board's trajectory")
    sightings_per_knot: float = Field(1.5, gt=0, description="the knot interval grows until this many sightings fall into one")
    max_offset_s: float = Field(0.05, gt=0, description="offsets beyond this are not searched")
    iterations: int = Field(8, ge=1, description="Gauss-Newton steps")
    least_moving: int = Field(8, ge=1, description="sightings of the moving board that each camera needs")
    coarsest_knot_s: float = Field(0.05, gt=0, description="where sightings allow no finer knots, motion is not used")
    moving_over_still: float = Field(2.5, gt=1, description="motion is used if its residual is at most this multiple")


class BumpSettings(_Frozen):
    """Search for cameras that moved after calibration."""

    max_angle_deg: float = Field(50.0, gt=0, description="views further apart are not matched")
    neighbours: int = Field(4, ge=2, description="views matched with each view")
    features: int = Field(4000, ge=100, description="SIFT features per view")
    ratio: float = Field(0.85, gt=0, lt=1, description="Lowe's ratio of best to second match")
    limit_px: float = Field(1.0, gt=0, description="a camera that disagrees with its neighbours by more is bumped")
    over_others: float = Field(3.0, gt=1, description="and by more than this multiple of the best quarter of pairs")
    min_matches: int = Field(12, ge=6, description="matches without which a pair of views says nothing")


class CalibrateSettings(_Frozen):
    """Settings of the calibrate stage."""

    detect: DetectSettings = Field(default_factory=DetectSettings, description="search for the board")
    group: GroupSettings = Field(default_factory=GroupSettings, description="board poses from all cameras")
    rig: RigSettings = Field(default_factory=RigSettings, description="bundle adjustment")
    timing: TimingSettings = Field(default_factory=TimingSettings, description="offsets from the moving board")
    bump: BumpSettings = Field(default_factory=BumpSettings, description="cameras moved after calibration")
    limits: CalibrateLimits = Field(default_factory=CalibrateLimits, description="quality gates")
