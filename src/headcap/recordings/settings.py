"""What ingest asks of recordings, and how frames are brought to a common moment."""

from pydantic import BaseModel, ConfigDict, Field


class IngestSettings(BaseModel):
    """Limits past which a recording is refused."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    rate_tolerance: float = Field(
        0.005, gt=0, description="relative difference of the frame rate that is taken as the same (59.94 for 60 is)"
    )
    black_level: float = Field(
        12, ge=0, description="grey value (0-255) that the brightest percent of a black picture stays below"
    )
    frozen_level: float = Field(0.6, ge=0, description="grey value by which no part of a frozen picture ever changes")
    silence_level: float = Field(1e-4, ge=0, description="peak (full scale 1) that silent sound stays below")
    still_level: float = Field(
        2.0, gt=0, description="grey value by which no part of a frame differs from the one before where nothing moves"
    )
    frozen_min_s: float = Field(
        0.1, gt=0, description="shortest stretch without change, while other cameras see motion, that is told as a freeze"
    )
    start_spread_s: float = Field(
        5.0, ge=0, description="cameras of a take start within this; sought when a freeze is compared with other cameras"
    )
    gap_max_s: float = Field(0.25, gt=0, description="longest gap in a recording's pictures; shorter ones are dropped frames")
    sound_checked_s: float = Field(120.0, gt=0, description="how much of the sound is listened to")


class FrameSettings(BaseModel):
    """How an image is brought to a moment between two frames."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    untouched_fraction: float = Field(0.02, ge=0, lt=0.5, description="nearer to a frame than this share of the interval: use it")
    still_level: float = Field(1.5, gt=0, description="mean grey difference of an 8x8 cell above which it counts as moving")
    margin_px: int = Field(24, ge=0, description="border around what moves that flow is computed on as well")
    bridged_frames: int = Field(2, ge=0, description="dropped frames in a row that flow may bridge")
    frames_cached: int = Field(5, ge=4, description="decoded frames kept per camera")
