"""Settings of the monocular base tracker."""

from pydantic import BaseModel, ConfigDict, Field


class IdentitySettings(BaseModel):
    """Who somebody is, from frames in which the head turns; ours."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    key_frames: int = Field(8, ge=2, description="Frames that are used at most")
    least_turn_deg: float = Field(12.0, gt=0, description="Turn of the head from the first frame, below which one frame must do")
    harmonics: int = Field(40, ge=0, description="Of the medium-scale layer beyond the model's shapes; 0 for none")
    harmonic_mm: float = Field(2.0, gt=0, description="Root mean square displacement expected of its longest wave")
    rounds: int = Field(3, ge=1, description="Times that the skin is followed anew, each from where the last one left it")
    places: int = Field(600, ge=50, description="Places of the skin that are followed")
    edge_px: float = Field(4.0, gt=0, description="Median edge of the mesh in the pictures in which they are followed, at most")
    flow_noise_px: float = Field(
        1.0, gt=0, description="Standard deviation of where they are found: neighbours err together, so more than one alone does"
    )
    expression_spread: float = Field(
        0.1,
        gt=0,
        description="Deviation of expression and jaw in these frames over that in others: somebody who turns the head for the "
        "camera makes no faces; wider, expressions of each frame take up what is the person's",
    )


class MonocularSettings(BaseModel):
    """Where the paper refers to Garrido et al. 2016 without numbers, these are ours."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    expressions: int = Field(100, ge=0, description="Leading expression coefficients that are estimated")
    shapes: int = Field(30, ge=0, description="Leading shape coefficients, estimated at the first frame and kept")
    harmonics: int = Field(
        0,
        ge=0,
        description="Of the medium-scale layer beyond the model's shapes; 0 for none. One frame's shading does not tell them: "
        "with 20, five rehearsed heads lie 0.16 px nearer in the picture, and 0.15 mm farther in space, 3.4 mm over the face",
    )
    harmonic_mm: float = Field(2.0, gt=0, description="Root mean square displacement expected of its longest wave")
    levels: int = Field(3, ge=1, description="Resolutions, each half the one before")
    finest_edge_px: float = Field(
        2.5, gt=0, description="Median edge of the mesh at the finest resolution: colours per vertex cannot show more"
    )
    iterations: int = Field(6, ge=1, description="Gauss-Newton steps per resolution at most")
    step_px: float = Field(0.03, gt=0, description="A step that moves the skin by less, rms, is the last of its resolution")
    least_noise: float = Field(0.004, gt=0, description="Standard deviation of linear intensity below which nothing is believed")
    robust_sigmas: float = Field(4.0, gt=0, description="Residual, in standard deviations, at which a pixel loses half its say")
    correlated_mm: float = Field(
        10.0,
        gt=0,
        description="Reach on the skin within which errors of the rendering are alike: pixels there count as one. What errs is "
        "albedo painted on a shape that is not the person's own, in patches; with 1.5 mm expressions bend in depth to mend it",
    )
    correlated_start_mm: float = Field(
        10.0, gt=0, description="The same at the first frame, where the skin's albedo is unknown and errs as its patches do"
    )
    steady_mm: float = Field(
        4.0, gt=0, description="Rms displacement by expressions and jaw at which skin has half its say in the head's motion"
    )
    jaw_deg: tuple[float, float, float] = Field((10.0, 2.0, 2.0), description="Standard deviations of the jaw's rotation vector")
    focal_spread: float = Field(0.25, gt=0, description="Standard deviation of the logarithm of an unknown focal length")
    expression_step: float = Field(0.35, gt=0, description="Standard deviation of an expression coefficient's change in a frame")
    jaw_step_deg: float = Field(3.0, gt=0, description="Of the jaw's turn in a frame")
    light_stiffness: float = Field(0.02, ge=0, description="Share of the data's weight with which light stays as it was")
    albedo_stiffness: float = Field(
        0.05, gt=0, description="Pixels' worth of weight with which unseen skin looks like its region"
    )
    least_face_score: float = Field(
        0.41, ge=-1, le=1, description="Likeness to the generic face, below which a picture without given landmarks shows none"
    )
    landmark_noise_share: float = Field(
        0.03, gt=0, description="Standard deviation of given landmarks over the distance of the outer eye corners"
    )
    flow_points: int = Field(300, ge=0, description="Pieces of skin followed from frame to frame to start from; 0 for none")
    flow_noise_px: float = Field(0.7, gt=0, description="Standard deviation of where they are found")
    most_noise_share: float = Field(
        0.06, gt=0, description="Most of the residuals' spread, over the skin's brightness, that is noise"
    )
    noise_growth: float = Field(3.0, gt=1, description="The same over the usual spread of the frames before")
    restart_growth: float = Field(
        2.0, gt=1, description="Most of a returning face's residuals over the usual spread: what agrees worse is another thing"
    )
    least_correlation: float = Field(0.6, ge=-1, le=1, description="Of rendering and picture, below which the face is lost")
    least_inliers: float = Field(0.5, ge=0, le=1, description="Share of the skin that must look as expected, or the face is lost")
    least_visible: float = Field(0.4, ge=0, le=1, description="Share of the skin known at the first frame that must be in view")
    identity: IdentitySettings = Field(IdentitySettings(), description="Who somebody is, where frames show the head turned")
