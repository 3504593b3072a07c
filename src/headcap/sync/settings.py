"""How claps are found and turned into start times."""

import math

from pydantic import BaseModel, ConfigDict, Field


class SyncSettings(BaseModel):
    """Clap detection, pairwise delays and the robust fit."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    temperature_c: float = Field(20.0, ge=-20, le=50, description="of the air in the room, for the speed of sound")
    highpass_hz: float = Field(2000.0, gt=0, description="claps are sought above this frequency, where voices are weak")
    attack_s: float = Field(0.002, gt=0, description="length of sound behind an onset that is compared with what was before")
    background_s: float = Field(0.050, gt=0, description="length of sound before an onset that it is compared with")
    min_background_s: float = Field(0.005, gt=0, description="least sound before an onset, at a recording's beginning")
    onset_jump_db: float = Field(12.0, gt=0, description="energy jump that makes an onset")
    onset_below_loudest_db: float = Field(25.0, gt=0, description="an onset this much weaker than the loudest is none")
    onset_hold_s: float = Field(0.1, gt=0, description="onsets nearer to each other than this are one sound")
    coarse_step_s: float = Field(0.002, gt=0, description="time step of the first, coarse alignment")
    cluster_s: float = Field(
        0.02, gt=0, description="onsets of different cameras within this are one event, after coarse alignment"
    )
    least_cameras_share: float = Field(0.5, gt=0, le=1, description="share of the cameras that must hear an event")
    window_before_s: float = Field(0.010, gt=0, description="sound before the onset that enters the delay estimate")
    window_after_s: float = Field(0.050, gt=0, description="sound behind the onset that enters the delay estimate")
    max_lag_s: float = Field(0.015, gt=0, description="largest error of an onset that the delay estimate mends")
    onset_error_s: float = Field(0.0015, gt=0, description="usual error of an onset; lags far beyond it are taken for echoes")
    least_sharpness: float = Field(0.15, ge=0, le=1, description="correlation below which two sounds are not the same event")
    upsampling: int = Field(8, ge=1, description="of the correlation, before the parabola through its peak")
    band_hz: tuple[float, float] = Field(
        (300.0, 16000.0), description="frequencies used for delays; lossy codecs drop what is above"
    )
    pair_scale_s: float = Field(3e-5, gt=0, description="residual at which a pair's weight halves (Cauchy)")
    pair_tolerance_s: float = Field(3e-4, gt=0, description="a pair within this of the solution agrees with it")
    min_confidence: float = Field(0.4, ge=0, le=1, description="a camera agreeing with fewer of the others is refused")
    drift_min_span_s: float = Field(5.0, gt=0, description="two claps farther apart than this give each clock's drift")
    max_drift_ppm: float = Field(200.0, gt=0, description="more drift than this is taken for sounds from two different places")

    @property
    def speed_of_sound(self) -> float:
        """In dry air, metres per second."""
        return 331.3 * math.sqrt(1 + self.temperature_c / 273.15)
