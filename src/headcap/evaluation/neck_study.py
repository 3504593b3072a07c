"""Tables 1 and 2 of the neck paper (section 7) for the subjects of a study, the ablation, and the larynx against truth.

The paper's own rows stand in `PAPER_ERROR_DROPS` and `PAPER_REGRESSORS`, for orientation: other people, other cameras.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np

from headcap.artifacts import ArtifactError, load_json, save_json
from headcap.errors import InputError
from headcap.evaluation.metrics import Figure, make_figure
from headcap.evaluation.neck import LarynxCurve, LarynxFile, larynx_correlation
from headcap.evaluation.settings import EvaluateSettings
from headcap.neck.fits import NeckFits
from headcap.neck.voice.errors import VoiceErrorRow, VoiceErrors, in_millimetres
from headcap.speech import FeatureSet

KIND, SCHEMA = "neck_study", 1


@dataclass(frozen=True, eq=False)
class StudySubject:
    """One person of a study as the evaluation needs them."""

    fits: NeckFits
    recorded: bool
    """True where the meshes were tracked from recordings; False for a subject that entered as meshes."""
    larynx: Mapping[str, LarynxCurve] = field(default_factory=dict)
    """True curves by take, where truth is known."""


@dataclass(frozen=True)
class ErrorDropRow:
    """A row of table 1: by how much each stage lowers the mean 3D error over the neck, millimetres; None without such takes."""

    subject: str
    held_out: bool
    recorded: bool
    pose_mm: float | None
    expression_mm: float | None
    speech_mm: float | None
    frames: int = 0
    skipped: int = 0
    """Of the frames, those whose mesh was not finite."""


@dataclass(frozen=True)
class AblationRow:
    """Mean 3D error over the neck in speech takes with parts of the model switched off, millimetres (section 7.2)."""

    subject: str
    held_out: bool
    recorded: bool
    base_mm: float
    """The head model before training, by pose and expression."""
    neither_mm: float
    """Trained pose correctives and expressions, larynx and speech blendshapes off."""
    without_larynx_mm: float
    without_speech_mm: float
    full_mm: float

    @property
    def rises(self) -> bool:
        """Whether each part switched off raises the error."""
        return self.full_mm < min(self.without_larynx_mm, self.without_speech_mm) and self.full_mm < self.neither_mm


@dataclass(frozen=True)
class LarynxRow:
    """Correlation of the slide tau with the true larynx's height over a take; None where either is still."""

    subject: str
    held_out: bool
    recorded: bool
    take: str
    correlation: float | None


@dataclass(frozen=True)
class RegressorRow:
    """A row of table 2: a regressor's errors on frames that it was not trained on, beside predicting the training's mean."""

    voice: str
    """A user's name, or a group's."""
    kind: Literal["user", "generic"]
    feature_set: str
    """paper or pooled, as in `FeatureSet`."""
    training_frames: int
    test_frames: int | None
    phi: float
    """Mean L2 norm of the difference in phi, millimetres; in the paper's rows, of its own phi."""
    tau: float | None = None
    """Mean squared difference in tau, square millimetres; in the paper's rows, square pixels of its map. None: phi alone."""
    alpha: float | None = None
    """Mean squared difference in alpha."""
    phi_of_mean: float | None = None
    tau_of_mean: float | None = None
    alpha_of_mean: float | None = None

    @classmethod
    def of(cls, voice: VoiceErrors, row: VoiceErrorRow) -> RegressorRow:
        """One way in which a voice was trained, and its errors on what was left out."""
        told = in_millimetres(row.errors)
        return cls(
            voice=voice.voice,
            kind=voice.kind,
            feature_set=row.feature_set.value,
            training_frames=row.training_frames,
            test_frames=row.errors.frames,
            phi=told["phi_mm"],
            tau=told.get("tau_mm2"),
            alpha=told.get("alpha"),
            phi_of_mean=told["phi_mm_of_mean"],
            tau_of_mean=told.get("tau_mm2_of_mean"),
            alpha_of_mean=told.get("alpha_of_mean"),
        )


PAPER_ERROR_DROPS = (
    ErrorDropRow("paper #1", True, True, 0.23, 1.57, 0.26),
    ErrorDropRow("paper #2", True, True, 0.46, 1.25, 0.25),
    ErrorDropRow("paper #3", True, True, 0.32, 1.42, 0.28),
    ErrorDropRow("paper #4", True, True, 0.39, 1.21, 0.19),
)
"""Table 1 of the paper."""
PAPER_REGRESSORS = (
    RegressorRow("paper, user #1", "user", "paper", 2630, 320, 0.1188, 2.5766, 0.1066),
    RegressorRow("paper, user #2", "user", "paper", 1880, 500, 0.1245, 3.7709, 0.1227),
    RegressorRow("paper, user #3", "user", "paper", 2720, 640, 0.1034, 2.5341, 0.0615),
    # the number of test frames is misprinted
    RegressorRow("paper, male", "generic", "paper", 8050, None, 0.1131, 1.3792, 0.0737),
    RegressorRow("paper, female", "generic", "paper", 6214, 1925, 0.1776),
)
"""Table 2 of the paper. Its phi, and tau in pixels of its map, have scales of their own: read each error within its column."""


@dataclass(frozen=True)
class NeckStudy:
    """What a study says of the neck model and its voices."""

    name: str
    drops: tuple[ErrorDropRow, ...]
    ablation: tuple[AblationRow, ...]
    larynx: tuple[LarynxRow, ...]
    regressors: tuple[RegressorRow, ...] = ()

    @classmethod
    def of(cls, name: str, subjects: Sequence[StudySubject], regressors: Sequence[RegressorRow] = ()) -> NeckStudy:
        """From each subject's fits, in the order given; raises `InputError` for a curve of a take that was not fitted."""
        parts = [(_drop_row(s), _ablation_row(s), _larynx_rows(s)) for s in subjects]
        ablation = tuple(row for _, row, _ in parts if row is not None)
        larynx = tuple(row for _, _, rows in parts for row in rows)
        return cls(name, tuple(row for row, _, _ in parts), ablation, larynx, tuple(regressors))

    def figures(self, settings: EvaluateSettings, limits: Mapping[str, Mapping[str, float]] | None = None) -> list[Figure]:
        """Every row as figures, `session` naming the subject; limits hold for held-out subjects, those of the larynx for all.

        `limits` by subject and figure go before those of `settings`.
        """
        out = []
        own = {row.subject: settings.with_limits((limits or {}).get(row.subject, {})) for row in self.drops}
        for row in self.drops:
            values = {"pose": row.pose_mm, "expression": row.expression_mm, "speech": row.speech_mm}
            named = {f"neck.{stage}_error_drop_mm": value for stage, value in values.items()}
            named["neck.skipped_frames"] = float(row.skipped)
            out += _figures(named, row.subject, own[row.subject], held=row.held_out)
        for row in self.ablation:
            named = {
                "neck.base_error_mm": row.base_mm,
                "neck.error_mm": row.full_mm,
                "neck.larynx_part_mm": row.without_larynx_mm - row.full_mm,
                "neck.speech_part_mm": row.without_speech_mm - row.full_mm,
            }
            out += _figures(named, row.subject, own[row.subject], held=row.held_out)
        for row in self.larynx:
            name = "neck.larynx_correlation" if row.recorded else "neck.larynx_correlation_of_meshes"
            value = math.nan if row.correlation is None else row.correlation
            out.append(make_figure(name, value, session=row.subject, take=row.take, settings=own[row.subject]))
        return out + [figure for row in self.regressors for figure in _voice_figures(row, settings)]

    def save(self, path: Path | str) -> None:
        """Write as JSON artifact `headcap.neck_study/1`."""
        save_json(path, KIND, SCHEMA, asdict(self))

    @classmethod
    def load(cls, path: Path | str) -> NeckStudy:
        """Read what `save` wrote; raises `ArtifactError`."""
        content = load_json(path, KIND, SCHEMA)
        rows = {"drops": ErrorDropRow, "ablation": AblationRow, "larynx": LarynxRow, "regressors": RegressorRow}
        try:
            return cls(content["name"], **{key: tuple(row(**one) for one in content[key]) for key, row in rows.items()})
        except (KeyError, TypeError) as error:
            raise ArtifactError(f"{path} holds no whole study of the neck ({error}); make it again") from error


def collect_study(
    name: str, fits: Sequence[Path], errors: Sequence[Path], *, recorded: Sequence[str], larynxes: Sequence[LarynxFile]
) -> NeckStudy:
    """From files: everybody's fits, every voice's errors, who came from recordings, and what is known of larynges.

    Of a voice the rows are kept that were trained as its regressor was, with the paper's features and with ours.
    """
    curves = {(file.person, file.take): file.load() for file in larynxes}
    subjects = []
    for fit in map(NeckFits.load, fits):
        known = {take: curve for (person, take), curve in curves.items() if person == fit.person and curve is not None}
        subjects.append(StudySubject(fit, fit.person in recorded, known))
    voices = [VoiceErrors.load(path) for path in errors]
    rows = [
        RegressorRow.of(voice, row) for voice in voices for row in voice.rows if row.silence_removed == voice.kept.silence_removed
    ]
    return NeckStudy.of(name, subjects, rows)


def _drop_row(subject: StudySubject) -> ErrorDropRow:
    fits, values = subject.fits, subject.fits.figures()
    drops = (values.get(f"neck.{stage}_error_drop_mm") for stage in ("pose", "expression", "speech"))
    frames = sum(len(take.time_s) for take in fits.takes)
    return ErrorDropRow(fits.person, fits.held_out, subject.recorded, *drops, frames, int(values["neck.skipped_frames"]))


def _ablation_row(subject: StudySubject) -> AblationRow | None:
    """None for a person without a speech take."""
    stages = ("base", "expression", "without_larynx", "without_speech", "full")
    errors = [subject.fits.mean_error_mm(stage, "speech") for stage in stages]
    if not np.isfinite(errors).all():
        return None
    return AblationRow(subject.fits.person, subject.fits.held_out, subject.recorded, *errors)


def _larynx_rows(subject: StudySubject) -> list[LarynxRow]:
    fits, rows = {take.take: take for take in subject.fits.takes}, []
    for name, curve in subject.larynx.items():
        if name not in fits:
            raise InputError(
                f"a true larynx of take {name} of {subject.fits.person}",
                expected=f"one of the fitted takes {', '.join(fits)}",
                remedy="Name the take as its fit does.",
            )
        found = larynx_correlation(fits[name], curve.time_s, curve.height_m, clock_shift_s=curve.clock_shift_s)
        told = found if math.isfinite(found) else None
        rows.append(LarynxRow(subject.fits.person, subject.fits.held_out, subject.recorded, name, told))
    return rows


def _voice_figures(row: RegressorRow, settings: EvaluateSettings) -> list[Figure]:
    """Table 2's errors of the improved feature set as figures, `session` naming the voice."""
    if row.feature_set != FeatureSet.POOLED.value:
        return []
    told = {
        f"speech.{name}_error{ending}": getattr(row, name + ending)
        for name in ("phi", "tau", "alpha")
        for ending in ("", "_of_mean")
    }
    return _figures(told, row.voice, settings, held=True)


def _figures(values: Mapping[str, float | None], subject: str, settings: EvaluateSettings, *, held: bool) -> list[Figure]:
    """Figures of one subject; without limits where the subject was trained on."""
    made = [
        make_figure(name, value, session=subject, take=None, settings=settings)
        for name, value in values.items()
        if value is not None
    ]
    return made if held else [replace(figure, limit=None, ok=None) for figure in made]
