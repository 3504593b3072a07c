"""Session and study files: one typed model each, composed of the settings of every room.

A session is one person on one day. Paths in it are relative to its data root; a data root that is relative itself is
taken from the folder the command runs in. `${NAME}` and `${NAME:-default}` in the data root are read from the
environment.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from headcap.artifacts import Name
from headcap.calibration.board import BoardSettings
from headcap.calibration.settings import CalibrateLimits, CalibrateSettings
from headcap.evaluation.catalogue import CATALOGUE
from headcap.evaluation.settings import EvaluateSettings
from headcap.expressions.quasi_eigen import QuasiEigenSettings
from headcap.lips.inpainting.settings import InpaintingSettings
from headcap.lips.monocular.settings import MonocularSettings
from headcap.lips.training import LipTrainingSettings
from headcap.neck.training.pose_expression import PoseExpressionSettings
from headcap.neck.training.study import NeckTrainingSettings
from headcap.neck.voice.training import Voice, VoiceTrainingSettings
from headcap.reconstruction.settings import ReconstructSettings
from headcap.recordings.settings import IngestSettings
from headcap.registration.place import PlaceSettings
from headcap.registration.register import RegisterSettings
from headcap.registration.track_settings import TrackSettings
from headcap.sync.settings import SyncSettings
from headcap.synthetic.settings import MeshRehearsalSettings, RehearsalSettings, TakeKind

UNITS_M = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}
CALIBRATION = "calibration"
"""Name of the board's recording among a session's recordings."""

Vector = tuple[float, float, float]
_MOVING_LIPS = ("lips", "speech", "expression", "free", "pose", "turn")
"""Kinds of takes, the likeliest first that the mouth opens in."""


class _Settings(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Intrinsics(_Settings):
    """A lens that is known already."""

    matrix: tuple[Vector, Vector, Vector] = Field(description="K in pixels; the top-left pixel's centre is (0, 0).")
    distortion: tuple[float, float, float, float, float] = Field(
        default=(0.0, 0.0, 0.0, 0.0, 0.0), description="OpenCV k1, k2, p1, p2, k3."
    )


class SessionCamera(_Settings):
    """One camera of the rig."""

    name: Name = Field(description="Name of the camera, the same in every take.")
    file: str | None = Field(default=None, description="What stands for {camera} in file patterns; by default the name.")
    framing: Literal["face", "lips"] = Field(default="face", description="Whether it sees the whole head or the lips alone.")
    intrinsics: Intrinsics | None = Field(default=None, description="Known lens; estimated from the board by default.")


class _Recordings(_Settings):
    files: str | dict[str, str] = Field(
        description="A pattern with {camera} in it, or one path per camera; relative to the data root."
    )
    missing: tuple[str, ...] = Field(default=(), description="Cameras that did not record; any other missing file is refused.")
    offsets_s: dict[str, float] = Field(
        default_factory=dict, description="Start times by camera on the common clock, which override what sync finds."
    )
    clap: bool = Field(default=True, description="Whether a clap was recorded; without one, offsets_s must be complete.")


class CalibrationRecordings(_Recordings):
    """The board waved in front of the cameras, one recording per camera."""


class Take(_Recordings):
    """One take, one recording per camera."""

    name: Name = Field(description="Name of the take and of its results' folders.")
    kind: TakeKind = Field(description="What the subject does.")
    frames: tuple[int, int] | None = Field(
        default=None, description="First and last frame, counted on the camera that started last; by default all."
    )
    masks: str | None = Field(default=None, description="Pattern with {camera} and {frame} of silhouettes, white is subject.")
    lip_tattoo: bool | None = Field(
        default=None,
        description="Whether the lips are tattooed; without a word as rehearsed, else takes of kind lips are and others are not.",
    )

    @model_validator(mode="after")
    def _frames_in_order(self) -> Self:
        if self.name == CALIBRATION:
            raise ValueError("a take cannot be called calibration: that is the board's recording")
        if self.frames and not 0 <= self.frames[0] <= self.frames[1]:
            raise ValueError(f"frames {list(self.frames)} are not in order; expected [first, last] with 0 <= first <= last")
        return self


class Scan(_Settings):
    """A scan of the neutral face."""

    file: str = Field(description="PLY, OBJ or STL, relative to the data root.")
    unit: Literal["m", "cm", "mm", "in"] = Field(description="Unit of its coordinates.")
    texture: str | None = Field(default=None, description="Texture image, where the file does not name it itself.")
    picks: str | None = Field(default=None, description="JSON of named points on the scan; the scan aligns without.")


class FramesPerJob(_Settings):
    """How a take is cut into jobs. Results do not depend on it for reconstruct, and for track only through its anchors."""

    reconstruct: int = Field(default=5, ge=1, description="Frames of a reconstruct job.")
    track: int = Field(default=50, ge=1, description="Frames of a track job; each begins at an anchor frame.")


class Evaluate(EvaluateSettings):
    """What to compare the results with, and how."""

    truth: str | None = Field(
        default=None, description="Folder of the truth, relative to the data root; no other stage reads it."
    )


GATES: dict[str, float] = {
    "sync.pair_residual_median_ms": 0.2,
    "reconstruct.points": 2000.0,
    "register.error_p95_mm": 3.0,
    "track.cloud_distance_median_mm": 2.0,
}
"""Limits that hold a run up where a session names no other; calibrate's own are in its settings."""


class _Training(_Settings):
    """Settings of what is trained on tracked takes, of one session or of a study's."""

    train_expressions: PoseExpressionSettings = PoseExpressionSettings()
    train_neck: NeckTrainingSettings = NeckTrainingSettings()
    track_monocular: MonocularSettings = MonocularSettings()
    train_lips: LipTrainingSettings = LipTrainingSettings()
    quasi_eigen: QuasiEigenSettings = QuasiEigenSettings()


class Session(_Training):
    """One capture session, from recordings to tracked meshes; in a study, the study's own settings train."""

    session: Name = Field(description="Name of the session; results go to results/<session>.")
    subject: str = Field(description="Who was recorded.")
    data_root: str = Field(description="Folder that all paths are relative to.")
    rate_hz: float = Field(gt=0, description="Frames per second of every camera.")
    cameras: tuple[SessionCamera, ...] = Field(min_length=3, description="The cameras, in the rig's order.")
    board: str | BoardSettings = Field(description="The calibration board: a YAML file or its content.")
    calibration: CalibrationRecordings = Field(description="Recordings of the board.")
    takes: tuple[Take, ...] = Field(min_length=1, description="The takes.")
    scan: Scan = Field(description="Scan of the neutral face.")
    clapper_m: Vector = Field(
        default=(0.0, -0.05, 0.3),
        description="Rough place of the clapper, metres, from the point the cameras look at: right (as the cameras in front "
        "see it), up and out of the face. Good to 15 cm is good enough where the board's recording has a clap too.",
    )
    limits: dict[str, float] = Field(default_factory=dict, description="Limits of quality gates, by figure.")
    allow: tuple[str, ...] = Field(default=(), description="Gates that may fail: the run goes on and the report shows it.")
    frames_per_job: FramesPerJob = FramesPerJob()
    ingest: IngestSettings = IngestSettings()
    calibrate: CalibrateSettings = CalibrateSettings()
    reconstruct: ReconstructSettings = ReconstructSettings()
    sync: SyncSettings = SyncSettings()
    register_scan: RegisterSettings = Field(default=RegisterSettings(), alias="register")
    place: PlaceSettings = PlaceSettings()
    track: TrackSettings = TrackSettings()
    train_speech: VoiceTrainingSettings | None = Field(
        default=VoiceTrainingSettings(), description="null: speech takes have no sound, and no regressor is trained."
    )
    lip_camera: Name | None = Field(
        default=None, description="Camera that stands for a single video where lips are learnt; by default the most frontal one."
    )
    untattooed_take: Name | None = Field(
        default=None,
        description="Take that shows the lips without tattoo, for takes with one to be painted over; by default the first "
        "of lips, else of speech, of expressions, a free one, of poses.",
    )
    inpaint_lips: InpaintingSettings = InpaintingSettings()
    expression_basis: str | None = Field(
        default=None,
        description="Hand-made expressions of this person, which become quasi-eigen faces: a folder of OBJ or PLY files, a glTF "
        "or USD file, or npz; relative to the data root.",
    )
    evaluate: Evaluate = Evaluate()
    rehearse: RehearsalSettings | None = Field(
        default=None, description="Render the recordings first; what the session does not say is then taken from here."
    )

    def gate_limits(self, stage: str) -> dict[str, float]:
        """Limits of a stage's gates by figure: the general ones and the session's."""
        return {figure: limit for figure, limit in (GATES | self.limits).items() if figure.startswith(f"{stage}.")}

    def figure_limits(self) -> dict[str, float]:
        """The session's limits of figures that `evaluate` lists."""
        return {figure: limit for figure, limit in self.limits.items() if figure in CATALOGUE}

    @property
    def root(self) -> Path:
        """The data root as a path."""
        return Path(expand_environment(self.data_root))

    def recordings(self, name: str) -> dict[str, str]:
        """Path of each camera's recording of a take, or of the board's recording, in the rig's order."""
        where = self.recorded(name)
        return {
            camera.name: str(self.root / _file_of(where.files, camera))
            for camera in self.cameras
            if camera.name not in where.missing and _file_of(where.files, camera)
        }

    def recorded(self, name: str) -> CalibrationRecordings | Take:
        """The take of that name, or the board's recording."""
        return self.calibration if name == CALIBRATION else next(take for take in self.takes if take.name == name)

    @property
    def tattooed_takes(self) -> tuple[str, ...]:
        """Takes in which the lips are tattooed."""
        return tuple(take.name for take in self.takes if self._lips_tattooed(take))

    @property
    def bare_take(self) -> str | None:
        """The take that shows the lips without their tattoo, by default one in which they move; None where there is none."""
        tattooed = self.tattooed_takes
        bare = [take for take in self.takes if take.name not in tattooed]
        liveliest = min(bare, key=lambda take: _MOVING_LIPS.index(take.kind), default=None)
        return self.untattooed_take or (liveliest and liveliest.name)

    def _lips_tattooed(self, take: Take) -> bool:
        rehearsed = {} if self.rehearse is None else {made.name: made.lips_tattooed for made in self.rehearse.takes}
        return rehearsed.get(take.name, take.kind == "lips") if take.lip_tattoo is None else take.lip_tattoo

    def path(self, relative: str) -> str:
        """A path of the session file, from the data root."""
        return str(self.root / relative)


class MeshTake(_Settings):
    """One take of a subject that comes as meshes."""

    name: Name = Field(description="Name of the take.")
    kind: TakeKind = Field(description="What the subject does.")
    sequence: str = Field(description="Mesh sequence (JSON) in the base head's topology.")
    sound: str | None = Field(default=None, description="Recording of the voice; its clock is the sequence's.")
    video: str | None = Field(default=None, description="What one camera saw of the take; its clock is the sequence's.")
    larynx: str | None = Field(default=None, description="True height of the larynx, npz: time_s, larynx_dy_m.")


class MeshSubject(_Settings):
    """A person whose tracked takes come from elsewhere, or are rehearsed without pictures."""

    subject: Name = Field(description="Name of the person; what is rehearsed goes to results/<subject>.")
    template: str = Field(description="The person's neutral head (npz), in the base head's topology.")
    camera: str | None = Field(default=None, description="The camera of the videos (JSON), in the sequences' world.")
    takes: tuple[MeshTake, ...] = Field(min_length=1, description="The takes.")
    expression_basis: str | None = Field(
        default=None, description="Hand-made expressions of this person, which become quasi-eigen faces; as a session's."
    )
    limits: dict[str, float] = Field(default_factory=dict, description="Limits of this person's figures.")
    rehearse_meshes: MeshRehearsalSettings | None = Field(
        default=None, description="Make the takes first; what the entry does not say is then taken from here."
    )

    def take(self, name: str) -> MeshTake:
        """The take of that name."""
        return next(take for take in self.takes if take.name == name)


class Study(_Training):
    """Sessions that are worked on together: who trains, and who is held out to be tested on."""

    study: Name = Field(description="Name of the study; its results go to results/<study>.")
    sessions: tuple[str | dict, ...] = Field(default=(), description="Session files, or their content.")
    mesh_subjects: tuple[MeshSubject, ...] = Field(default=(), description="Further people, without recordings.")
    held_out: tuple[Name, ...] = Field(default=(), description="Sessions and mesh subjects that nothing is trained on.")
    groups: tuple[Voice, ...] = Field(default=(), description="Generic regressors beside each person's own.")
    train_speech: VoiceTrainingSettings = VoiceTrainingSettings()


def schemas() -> dict[str, dict]:
    """JSON schemas of session and study files, by the name of their file."""
    study = Study.model_json_schema()
    session = Session.model_json_schema()
    # what a rehearsed session or subject does not say is filled in from its rehearsal
    session["anyOf"] = [{"required": session.pop("required")}, {"required": ["session", "rehearse"]}]
    meshes = study["$defs"]["MeshSubject"]
    meshes["anyOf"] = [{"required": meshes.pop("required")}, {"required": ["subject", "rehearse_meshes"]}]
    return {"session": _draft | session, "study": _draft | study}


_draft = {"$schema": "https://json-schema.org/draft/2020-12/schema"}


def expand_environment(text: str) -> str:
    """Replace `${NAME}` and `${NAME:-default}`; an unset name without a default becomes empty."""
    return re.sub(r"\$\{(\w+)(?::-([^}]*))?\}", lambda match: os.environ.get(match[1]) or match[2] or "", text)


def session_files(session: Session) -> Iterator[tuple[str, str]]:
    """Each file that a session names and its key, but for what a rehearsal renders."""
    if session.rehearse is not None:
        return
    if isinstance(session.board, str):
        yield "board", session.path(session.board)
    yield "scan.file", session.path(session.scan.file)
    for key in ("texture", "picks"):
        if value := getattr(session.scan, key):
            yield f"scan.{key}", session.path(value)
    for name, key in ((CALIBRATION, CALIBRATION), *((take.name, f"takes.{take.name}") for take in session.takes)):
        for camera, path in session.recordings(name).items():
            yield f"{key}.files ({camera})", path
    if session.expression_basis:
        yield "expression_basis", session.path(session.expression_basis)
    if session.evaluate.truth:
        yield "evaluate.truth", session.path(session.evaluate.truth)


def known_figures() -> set[str]:
    """Figures that a limit can be set for or waived."""
    return {*CATALOGUE, *GATES, "calibrate.bump_residual_px", *(f"calibrate.{name}" for name in CalibrateLimits.model_fields)}


def disagreements(session: Session) -> list[str]:
    """Names that are given twice, and cameras that a take names but the session does not."""
    cameras = [camera.name for camera in session.cameras]
    takes = [take.name for take in session.takes]
    told = [
        f"{kind}: {name} is named twice"
        for kind, names in (("cameras", cameras), ("takes", takes))
        for name in sorted({name for name in names if names.count(name) > 1})
    ]
    if session.lip_camera is not None and session.lip_camera not in cameras:
        told.append(f"lip_camera: no camera is called {session.lip_camera}")
    bare = session.untattooed_take
    if bare is not None and bare not in takes:
        told.append(f"untattooed_take: no take is called {bare}")
    elif bare in session.tattooed_takes:
        told.append(f"untattooed_take: the lips are tattooed in {bare}")
    unknown = sorted({*session.limits, *session.allow} - known_figures())
    told += [f"limits, allow: no figure is called {name}" for name in unknown]
    for key, where in ((CALIBRATION, session.calibration), *((f"takes.{take.name}", take) for take in session.takes)):
        files = where.files if isinstance(where.files, dict) else {}
        told += [
            f"{key}: no camera is called {name}" for name in sorted({*where.missing, *where.offsets_s, *files} - set(cameras))
        ]
        if isinstance(where.files, dict):
            told += [f"{key}: no file for {name}" for name in cameras if name not in files and name not in where.missing]
    return told


def _file_of(files: str | dict[str, str], camera: SessionCamera) -> str:
    if isinstance(files, dict):
        return files.get(camera.name, "")
    return files.replace("{camera}", camera.file or camera.name)
