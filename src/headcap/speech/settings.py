"""How pitch is tracked, features are pooled and regressors are trained."""

import math

from pydantic import BaseModel, ConfigDict, Field


class PitchSettings(BaseModel):
    """Pitch by correlation and the cheapest path; costs are per step of 10 ms, as Boersma 1993 gives them.

    None is fine-tuned: against a laryngograph, octave costs of 0.01 to 0.1 give 0.3 to 0.4 % gross errors and agree on
    voice in 94.2 to 94.8 % of the steps; look-ahead beyond 40 ms changes nothing, none at all costs 0.2 %.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    lowest_hz: float = Field(80.0, ge=50, le=200, description="lowest pitch; b1 = 0 (paper section 7)")
    highest_hz: float = Field(350.0, ge=200, le=600, description="highest pitch; b1 = 1 (paper section 7)")
    window_s: float = Field(0.040, ge=0.03, le=0.1, description="sound that one pitch estimate sees: three longest periods")
    voicing_threshold: float = Field(0.45, gt=0, lt=1, description="correlation at which voiced and unvoiced are even")
    octave_cost: float = Field(0.05, ge=0, le=0.3, description="correlation that a doubled period must gain to be preferred")
    octave_jump_cost: float = Field(0.35, ge=0, description="of a change of pitch by one octave")
    voicing_change_cost: float = Field(0.14, ge=0, description="of a change between voiced and unvoiced")
    pause_below_speech_db: float = Field(15.9, ge=0, description="sound this far below active speech is half lost in the pause")
    candidates: int = Field(8, ge=1, le=20, description="pitches kept per step")
    lookahead_s: float = Field(0.080, ge=0, le=1, description="later sound that may still change a decision")


class FeatureSettings(BaseModel):
    """Audio features of a visual frame."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    pitch: PitchSettings = Field(default_factory=PitchSettings, description="how pitch is tracked")
    pooled_orders: int = Field(6, ge=1, le=64, description="cosines over the 520 ms that pooled features keep of each course")


class RidgeSettings(BaseModel):
    """Penalties that cross-validation chooses from, as multiples of the inputs' mean power.

    The lambda of eq. 25 is such a multiple times tr(X^T X) / p, so that the range fits any units and any number of frames.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    least: float = Field(1e-4, gt=0, description="smallest penalty tried")
    most: float = Field(1e2, gt=0, description="largest penalty tried")
    per_decade: int = Field(2, ge=1, le=10, description="penalties tried in each factor of ten")
    parts_of_one_take: int = Field(5, ge=2, description="stretches that a single take is cut into for cross-validation")
    block_frames: int = Field(1024, ge=1, description="frames whose windows are in memory at a time")

    @property
    def penalties(self) -> tuple[float, ...]:
        """In rising order."""
        decades = math.log10(self.most / self.least)
        return tuple(self.least * 10 ** (k / self.per_decade) for k in range(round(decades * self.per_decade) + 1))
