"""What a rehearsal is made of: rig, subject, board, takes, lights and defects."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from headcap.synthetic.sculptor import SculptorSettings

Vector = tuple[float, float, float]
TakeKind = Literal["pose", "expression", "speech", "lips", "free", "turn"]
LipShape = Literal[
    "pucker", "press", "spread", "tuck", "bare_upper", "bare_lower", "round_open", "smile", "smirk_left", "smirk_right", "frown",
    "kiss", "roll_in", "roll_out", "puff", "side_left", "side_right", "jaw_open",
]  # fmt: skip


X264_PRESET = "ultrafast"
"""Of rehearsed recordings. At their quality most of what is coded is sensor noise, which search and prediction do not make
smaller: against `veryfast` a view of 360x640 takes 3 ms in the place of 8 and 11 kB in the place of 13, decodes in half the time,
and errs no more (mean squared error of luma 0.87 and 0.95)."""


class _Settings(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class CameraSettings(_Settings):
    """One camera of a described rig."""

    name: str = Field(description="Name of the camera and of its files.")
    position_m: Vector = Field(description="Optical centre, metres, world of the subject (y up, z out of the face).")
    look_at_m: Vector = Field(default=(0.0, -0.045, 0.015), description="Point on the optical axis, metres.")
    roll_deg: float = Field(default=0.0, description="Turn about the optical axis.")
    vertical_fov_deg: float = Field(default=30.0, gt=1, lt=150, description="Field of view along the image's height.")
    principal_point_offset_px: tuple[float, float] = Field(default=(0.0, 0.0), description="From the image's centre.")
    distortion: tuple[float, float, float, float, float] = Field(
        default=(0.0, 0.0, 0.0, 0.0, 0.0), description="OpenCV k1, k2, p1, p2, k3."
    )


class ArcSettings(_Settings):
    """Cameras on rows of an arc about the face, each placed and built a little differently."""

    cameras: int = Field(default=16, ge=3, description="Number of cameras, dealt out to the rows in turn.")
    rows_deg: tuple[float, ...] = Field(default=(-17.0, 15.0), min_length=1, description="Elevation of each row.")
    half_angle_deg: float = Field(default=76.0, gt=0, le=180, description="Azimuth of the outermost cameras.")
    distance_m: float = Field(default=0.76, gt=0.1, description="From the target to the cameras.")
    target_m: Vector = Field(default=(0.0, -0.045, 0.015), description="What the cameras look at, metres.")
    vertical_fov_deg: float = Field(default=33.0, gt=1, lt=150, description="Field of view along the image's height.")
    placement_sigma_m: float = Field(default=0.02, ge=0, description="Random shift of each camera.")
    aim_sigma_deg: float = Field(default=0.6, ge=0, description="Random turn of each camera, about each axis.")
    fov_sigma: float = Field(default=0.015, ge=0, description="Relative spread of focal lengths.")
    principal_point_sigma_px: float = Field(default=4.0, ge=0, description="Spread of principal points.")
    distortion: tuple[float, float, float, float, float] = Field(
        default=(-0.08, 0.05, 0.0, 0.0, 0.0), description="Mean OpenCV k1, k2, p1, p2, k3."
    )
    distortion_sigma: tuple[float, float, float, float, float] = Field(
        default=(0.006, 0.012, 0.0005, 0.0005, 0.0), description="Spread of each distortion coefficient."
    )


class LightSettings(_Settings):
    """One soft light, far away."""

    direction: Vector = Field(description="From the subject to the light; any length.")
    intensity: float = Field(gt=0, description="Irradiance on a surface that faces it, 1 = white skin fully lit.")
    colour: Vector = Field(default=(1.0, 1.0, 1.0), description="Linear RGB.")
    spread_deg: float = Field(default=14.0, ge=0, lt=80, description="Half angle of the area that shines: softness of shadows.")


class SensorSettings(_Settings):
    """Exposure, colour and noise of the cameras."""

    exposure_sigma: float = Field(default=0.06, ge=0, description="Relative spread of exposure between cameras.")
    white_balance_sigma: float = Field(default=0.03, ge=0, description="Relative spread of the red and blue gains.")
    read_noise: float = Field(default=0.0015, ge=0, description="Noise of a black pixel, share of full scale (linear).")
    shot_noise: float = Field(default=0.006, ge=0, description="Noise of a white pixel, share of full scale (linear).")
    background: float = Field(default=0.055, ge=0, description="Linear brightness of the room behind the subject.")
    rolling_shutter_s: float = Field(default=0.0, ge=0, description="Time from the first to the last row.")
    rolling_shutter_bands: int = Field(default=8, ge=2, description="Bands of rows, each rendered at its own moment.")


class DroppedFrames(_Settings):
    """Frames that one camera loses in every recording."""

    camera: str = Field(description="Name of the camera.")
    frames: tuple[int, ...] = Field(description="Frame slots, from 0.")


class ClockSettings(_Settings):
    """How the recordings' clocks differ."""

    start_spread_s: float = Field(default=0.15, ge=0, description="Recordings start anywhere within this time.")
    drift_ppm_sigma: float = Field(default=0.0, ge=0, description="Spread of clock rates, parts per million.")
    dropped_share: float = Field(default=0.0, ge=0, lt=0.5, description="Share of frames that are missing, at random.")
    dropped_frames: tuple[DroppedFrames, ...] = Field(default=(), description="Frames that are missing beside the random ones.")
    audio_lag_sigma_s: float = Field(default=0.0, ge=0, description="Spread of the sound track's own lag behind the picture.")


class SoundSettings(_Settings):
    """The clap, the room and the microphones."""

    clap_time_s: float = Field(default=0.22, gt=0, description="Moment the clapper closes.")
    clap_position_m: Vector = Field(default=(0.02, -0.12, 0.3), description="Place of the clapper.")
    speed_m_s: float = Field(default=343.0, gt=0, description="Speed of sound.")
    cough: bool = Field(default=False, description="A cough before the clap.")
    second_clap_s: float | None = Field(default=None, description="Moment of a second clap, for measuring drift.")
    noise: float = Field(default=0.002, ge=0, description="Room and microphone noise, rms, full scale 1.")
    echoes: int = Field(default=6, ge=0, description="Reflections off the room's walls.")
    rate_hz: int = Field(default=48000, gt=8000, description="Sampling rate of the sound tracks.")


class BoardSettings(_Settings):
    """The ChArUco board and how it is waved."""

    dictionary: str = Field(default="DICT_5X5_100", description="OpenCV's name of the marker dictionary.")
    squares: tuple[int, int] = Field(default=(7, 9), description="Squares across and down.")
    square_size_mm: float = Field(default=25.0, gt=0, description="Side of a square.")
    marker_size_mm: float = Field(default=18.0, gt=0, description="Side of a marker.")
    margin_mm: float = Field(default=8.0, ge=0, description="White border.")
    inverted: bool = Field(default=False, description="Print black as white and white as black.")
    duration_s: float = Field(default=8.0, gt=0.3, description="Length of the recording.")
    hold_s: float = Field(default=0.2, gt=0, description="Time the board rests in each pose.")
    move_s: float = Field(default=0.12, gt=0, description="Time between two poses.")
    spread_m: Vector = Field(default=(0.06, 0.07, 0.06), description="Poses lie within this of the target, each axis.")
    tilt_deg: float = Field(default=32.0, ge=0, lt=80, description="Tilt out of the direction the board is shown to.")


class TakeSettings(_Settings):
    """One take."""

    name: str = Field(description="Folder of the take.")
    kind: TakeKind = Field(description="What the subject does.")
    duration_s: float = Field(default=1.2, gt=0.45, description="Length of each recording.")
    intensity: float = Field(default=1.0, gt=0, description="Strength of the motion.")
    lip_tattoo: bool | None = Field(
        default=None, description="Tattoos on and about the lips; without a word takes of lips have them and others do not."
    )

    lip_shapes: tuple[LipShape, ...] = Field(
        default=(), description="What the lips do, one after the other, in a take of lips; without a word all, in random order."
    )

    @property
    def lips_tattooed(self) -> bool:
        """Whether the lips are tattooed in this take."""
        return self.kind == "lips" if self.lip_tattoo is None else self.lip_tattoo


class SubjectSettings(_Settings):
    """The subject."""

    identity: float = Field(default=1.0, ge=0, description="Strength of the difference from the generic head.")
    tattoos: bool = Field(default=True, description="Tattoos on neck and cheeks (and on the lips in lip takes).")
    detail_mm: float = Field(default=0.12, ge=0, description="Fine relief of the skin, rms.")
    larynx_prominence_mm: float = Field(default=5.0, ge=0, description="Height of the larynx bump.")


class ScanSettings(_Settings):
    """The neutral scan."""

    triangles: int = Field(default=120_000, gt=1000, description="Triangles of the scan.")
    noise_mm: float = Field(default=0.04, ge=0, description="Noise of each vertex, rms.")
    placement_m: Vector = Field(default=(0.12, -0.04, 0.3), description="Shift of the scan from the subject's world.")
    unit_m: float = Field(default=0.001, gt=0, description="Length of the scan's unit in metres.")


class VideoSettings(_Settings):
    """The recordings' format."""

    width: int = Field(default=360, gt=31, multiple_of=2, description="Pixels.")
    height: int = Field(default=640, gt=31, multiple_of=2, description="Pixels.")
    rate_hz: float = Field(default=30.0, gt=1, description="Frames per second.")
    crf: float = Field(default=13.0, ge=0, le=40, description="H.264 quality, lower is better.")


DEFAULT_LIGHTS = (
    LightSettings(direction=(0.3, 0.75, 1.0), intensity=0.42, colour=(1.0, 0.97, 0.93), spread_deg=16),
    LightSettings(direction=(-1.0, 0.35, 0.55), intensity=0.26, colour=(0.95, 0.98, 1.0), spread_deg=20),
    LightSettings(direction=(0.9, -0.1, 0.6), intensity=0.2, colour=(1.0, 1.0, 1.0), spread_deg=20),
)
DEFAULT_TAKES = (TakeSettings(name="free_01", kind="free", duration_s=1.0),)


FRONT = CameraSettings(name="front", position_m=(0.0, -0.045, 0.775), vertical_fov_deg=33.0)


class MeshVideoSettings(_Settings):
    """One camera that films a subject who is rehearsed as meshes; its frames are the moments of the meshes."""

    width: int = Field(default=360, gt=31, multiple_of=2, description="Pixels.")
    height: int = Field(default=640, gt=31, multiple_of=2, description="Pixels.")
    crf: float = Field(default=13.0, ge=0, le=40, description="H.264 quality, lower is better.")
    camera: CameraSettings = Field(default=FRONT, description="The camera: from the front, as far off as a rig's.")
    tattoos: bool = Field(default=False, description="Show the tattoos of subject and takes; true meshes need none.")
    sensor: SensorSettings = SensorSettings()
    lights: tuple[LightSettings, ...] = Field(default=DEFAULT_LIGHTS, description="The lights.")
    ambient: float = Field(default=0.28, ge=0, description="Irradiance from all around, dimmed where little sky is seen.")
    gloss: float = Field(default=0.03, ge=0, description="Shine of the skin: light that changes with the viewpoint.")


class MeshRehearsalSettings(_Settings):
    """A subject that is rehearsed without a rig: mesh sequences as they would be tracked without error, the voice, and one
    camera's view where that is asked for."""

    seed: int = Field(ge=0, description="Who it is and what the person does; equal seeds are equal people.")
    rate_hz: float = Field(default=30.0, gt=1, description="Frames per second.")
    takes: tuple[TakeSettings, ...] = Field(min_length=1, description="The takes.")
    subject: SubjectSettings = SubjectSettings()
    video: MeshVideoSettings | None = Field(default=None, description="Also film each take with one camera.")
    sculpt: SculptorSettings | None = Field(
        default=None, description="Also sculpt hand-made expressions of this person: `expressions.npz`, with these mistakes."
    )

    @model_validator(mode="after")
    def _names_differ(self) -> MeshRehearsalSettings:
        takes = [take.name for take in self.takes]
        if len(set(takes)) != len(takes):
            raise ValueError(f"names must differ: takes {takes}")
        return self


class RehearsalSettings(_Settings):
    """A whole rehearsal: all that is needed to make its files again, bit for bit on one machine."""

    seed: int = Field(default=1, ge=0, description="Seeds everything that is random.")
    cameras: tuple[CameraSettings, ...] | None = Field(default=None, description="The rig camera by camera; else `arc`.")
    arc: ArcSettings = Field(default=ArcSettings(), description="The rig as an arc, where `cameras` is not given.")
    video: VideoSettings = VideoSettings()
    sensor: SensorSettings = SensorSettings()
    clock: ClockSettings = ClockSettings()
    sound: SoundSettings = SoundSettings()
    lights: tuple[LightSettings, ...] = Field(default=DEFAULT_LIGHTS, description="The lights.")
    ambient: float = Field(default=0.28, ge=0, description="Irradiance from all around, dimmed where little sky is seen.")
    gloss: float = Field(default=0.03, ge=0, description="Shine of the skin: light that changes with the viewpoint.")
    board: BoardSettings = BoardSettings()
    takes: tuple[TakeSettings, ...] = Field(default=DEFAULT_TAKES, min_length=1, description="The takes.")
    subject: SubjectSettings = SubjectSettings()
    scan: ScanSettings = ScanSettings()
    sculpt: SculptorSettings | None = Field(
        default=None, description="Also sculpt hand-made expressions of this person: `expressions.npz`, with these mistakes."
    )

    @model_validator(mode="after")
    def _names_differ(self) -> RehearsalSettings:
        takes = [take.name for take in self.takes]
        cameras = [camera.name for camera in self.cameras or ()]
        if len(set(takes)) != len(takes) or len(set(cameras)) != len(cameras):
            raise ValueError(f"names must differ: takes {takes}, cameras {cameras}")
        if "calibration" in takes:
            raise ValueError("a take cannot be called calibration: that is the board's recording")
        return self
