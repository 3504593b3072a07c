"""The page of a study's neck model: tables 1 and 2, the ablation, figures 7 to 9 and 11 to 14; self-contained, no script."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from headcap.errors import InputError
from headcap.evaluation.neck_study import PAPER_ERROR_DROPS, PAPER_REGRESSORS, RegressorRow
from headcap.neck.animation.curves import CoefficientCurves
from headcap.neck.animation.swallowing import swallow
from headcap.neck.fits import NeckFits, TakeFit
from headcap.report import study_figures as diagrams
from headcap.report.overlays import jpeg_uri
from headcap.report.page import Shown, drawing, write_page
from headcap.report.study_inputs import Animation, StudyInputs
from headcap.report.study_pictures import (
    DIFFERENCE_TOP_MM,
    EXAGGERATED_ALPHA,
    EXAGGERATED_TAU,
    KeyFrame,
    animation_columns,
    swallow_columns,
)

MOST_ERROR_CURVES = 4
_DRIVEN = {
    "user": "Figure 11: a voice drives the neck of the person it was learnt from",
    "generic": "Figure 12: a generic voice drives the neck of a person whom it was not learnt from",
    "face": "Figure 13: a face's pose and expression drive its neck",
}


@dataclass(frozen=True)
class _Column:
    uri: str
    told: tuple[str, ...]


@dataclass(frozen=True)
class _Strip:
    """Key frames side by side."""

    title: str
    caption: str
    columns: tuple[_Column, ...]


def write_study_report(inputs: StudyInputs, path: Path | str) -> None:
    """Write the page as one HTML file; raises `InputError` where the fits are not those of the study's rows."""
    _check(inputs)
    study = inputs.study
    write_page(
        path,
        "study.html.j2",
        inputs,
        study=study,
        groups=dict(inputs.groups),
        trained=sum(not row.held_out for row in study.drops),
        held_out=sum(row.held_out for row in study.drops),
        past=[figure for figure in inputs.figures if figure.ok is False],
        subjects=[(row, _takes(fits)) for row, fits in zip(study.drops, inputs.fits, strict=True)],
        drops=sorted(study.drops, key=lambda row: not row.held_out) + list(PAPER_ERROR_DROPS),
        drops_picture=drawing(diagrams.error_drops_diagram(study), "error drops of held-out subjects, and the paper's in grey"),
        regressors=_regressors(study.regressors),
        curves=_curves(inputs),
        strips=_strips(inputs),
        difference_top=f"{DIFFERENCE_TOP_MM:g}",
    )


def _check(inputs: StudyInputs) -> None:
    named, fitted = [row.subject for row in inputs.study.drops], [fits.person for fits in inputs.fits]
    if named != fitted:
        raise InputError(
            f"fits of {', '.join(fitted) or 'nobody'}",
            expected=f"one for each of the study's rows in their order: {', '.join(named) or 'none'}",
            remedy="Give the fits that the study was made of.",
        )


def _takes(fits: NeckFits) -> str:
    counted = Counter(take.kind for take in fits.takes)
    return ", ".join(f"{count} {kind}" for kind, count in counted.items())


def _regressors(rows: tuple[RegressorRow, ...]) -> list[tuple[RegressorRow, bool, bool]]:
    """Rows with whether a voice begins there and whether they are the paper's: of one voice the paper's features come first."""
    order = list(dict.fromkeys((row.kind, row.voice) for row in rows))
    own = sorted(rows, key=lambda row: (order.index((row.kind, row.voice)), row.feature_set != "paper"))
    told, before = [], None
    for row in own:
        told.append((row, (row.kind, row.voice) != before, False))
        before = (row.kind, row.voice)
    return told + [(row, True, True) for row in PAPER_REGRESSORS]


def _curves(inputs: StudyInputs) -> list[Shown]:
    """Figures 7 to 9, of people held out where there are any."""
    people = [fits for fits in inputs.fits if fits.held_out] or list(inputs.fits)
    speech = [(fits, take) for fits in people for take in fits.of_kind("speech")]
    shown = []
    if speech:
        first = list({fits.person: (f"{fits.person}, {take.take}", take) for fits, take in reversed(speech)}.values())[::-1]
        image = diagrams.fitting_errors(first[:MOST_ERROR_CURVES])
        shown.append(drawing(image, "Figure 7: mean 3D error over the neck, frame by frame"))
        title, take = first[0]
        shown.append(drawing(diagrams.speech_weights(title, take), _weights_caption(take)))
    parts = _slides(inputs, people)
    if parts:
        caption = (
            "Figure 9: slide and scale of the larynx. Higher, it lies deeper; a head thrown back may show more of it all the same"
        )
        shown.append(drawing(diagrams.slide_and_scale_curves(parts), caption))
    return shown


def _weights_caption(take: TakeFit) -> str:
    told = "Figure 8: the first three weights of the speech blendshapes"
    lengths = diagrams.weights_when_neutral(take)
    if lengths is None:
        return told
    return f"{told}; phi is {lengths[0]:.2f} mm long in near-neutral stretches and {lengths[1]:.2f} mm elsewhere, on average"


def _slides(inputs: StudyInputs, people: list[NeckFits]) -> list[tuple[str, CoefficientCurves]]:
    """A swallow where one was fitted, then a speech and a pose take of the first person who has them."""
    parts = [] if inputs.swallow is None else [("swallow", inputs.swallow)]
    for kind in ("speech", "pose"):
        found = next(((fits, take) for fits in people for take in fits.of_kind(kind) if take.speech.known.any()), None)
        if found is not None:
            fits, take = found
            parts.append((f"{fits.person}, {take.take}", CoefficientCurves.of_take(take, inputs.model.version, fits.person)))
    return parts


def _strips(inputs: StudyInputs) -> list[_Strip]:
    """Figures 11 to 14."""
    order = list(_DRIVEN)
    drawn = [_animated(inputs, one) for one in sorted(inputs.animations, key=lambda one: order.index(one.drive))]
    person = inputs.swallower or next(iter(inputs.model.people), None)
    if person is None:
        return drawn
    curves = swallow(30.0) if inputs.swallow is None else inputs.swallow
    source = "the ready curve" if inputs.swallow is None else "as fitted from a take"
    caption = (
        f"First two rows: {source}, on {person.name}. Below: edited, slides {EXAGGERATED_TAU:g} times as far and the larynx"
        f" {EXAGGERATED_ALPHA:g} times as prominent."
    )
    columns = swallow_columns(inputs.model, person, curves)
    return [*drawn, _Strip("Figure 14: swallowing, and an exaggerated edit of it", caption, _columns(columns))]


def _animated(inputs: StudyInputs, animation: Animation) -> _Strip:
    rows = "From top to bottom: what the person did, the animation, and their difference." if animation.truth is not None else ""
    columns = animation_columns(inputs.model, animation)
    return _Strip(f"{_DRIVEN[animation.drive]}: {animation.title}", rows, _columns(columns))


def _columns(columns: list[KeyFrame]) -> tuple[_Column, ...]:
    return tuple(_Column(jpeg_uri(column.image), column.told) for column in columns)
