"""One page per session: gates, figures, pictures of every stage; self-contained, no script, no network."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image as PillowImage

from headcap.artifacts import atomic_path
from headcap.evaluation.catalogue import CATALOGUE, REFERENCE_PIXEL_MM, limit_factor
from headcap.evaluation.metrics import Figure
from headcap.report import figures as diagrams
from headcap.report import pictures
from headcap.report.inputs import CalibrationReport, RegisterReport, ReportInputs, TakeReport
from headcap.report.page import Shown, drawing, number, photograph, write_page


def write_report(inputs: ReportInputs, path: Path | str) -> None:
    """Write the report of a session as one HTML file."""
    rows = _rows(inputs)
    write_page(
        path,
        "template.html.j2",
        inputs,
        rows=rows,
        gates=_gates(rows),
        footnote=_footnote(inputs, rows),
        expectations=_expectations(inputs.figures),
        summary=_summary(inputs),
        calibration=_calibration(inputs.calibration, inputs) if inputs.calibration else None,
        register=_register(inputs.register, inputs) if inputs.register else None,
        takes=[(take, _sync(take, inputs), *_take(take, inputs)) for take in inputs.takes],
        neck=_neck(inputs),
    )


def write_summary(inputs: ReportInputs, path: Path | str) -> None:
    """Write a contact sheet as PNG: photograph, points, mesh and error of the liveliest sampled frame of each take."""
    views = _liveliest(inputs)
    if not views:
        raise ValueError(f"{inputs.session}: no tracked frame was sampled, so there is nothing to show")
    sheet = pictures.contact_sheet(views, inputs.register.template.triangles)
    with atomic_path(path) as temporary:
        PillowImage.fromarray(sheet).save(temporary, "png", optimize=True)


def _liveliest(inputs: ReportInputs) -> list:
    """Per take the sampled view whose mesh differs most from the first one."""
    if inputs.register is None:
        return []
    chosen = []
    for take in inputs.takes:
        if take.views:
            frame = max(take.views, key=lambda view: float(np.abs(view.vertices - take.neutral).mean())).frame
            chosen.append(next(view for view in take.views if view.frame == frame))
    return chosen


@dataclass(frozen=True)
class _Row:
    """One figure of the table."""

    figure: Figure
    state: str
    meaning: str
    waived: bool
    scaled: bool
    """Whether the limit was made larger for the size of a pixel on the skin."""


def _rows(inputs: ReportInputs) -> list[_Row]:
    """Rows of the table, in the order of the stages and the catalogue."""
    stages, names = (
        ("rig", "ingest", "sync", "calibrate", "reconstruct", "register", "place", "track", "neck", "speech"),
        list(CATALOGUE),
    )
    place = lambda options, key: options.index(key) if key in options else len(options)  # noqa: E731
    takes = [take.take for take in inputs.takes]
    ordered = sorted(
        inputs.figures,
        key=lambda f: (place(stages, f.name.split(".")[0]), place(names, f.name), f.name, place(takes, f.take)),
    )
    return [
        _Row(
            figure=figure,
            state={True: "good", False: "bad", None: "plain"}[figure.ok],
            meaning=CATALOGUE[figure.name].meaning if figure.name in CATALOGUE else "",
            waived=figure.ok is False and figure.name in inputs.allowed,
            scaled=_is_scaled(figure, limit_factor(_pixel_mm(inputs))),
        )
        for figure in ordered
    ]


def _pixel_mm(inputs: ReportInputs) -> float | None:
    return next((figure.value for figure in inputs.figures if figure.name == "rig.pixel_mm"), None)


def _is_scaled(figure: Figure, factor: float) -> bool:
    """Whether a limit is the default one times the factor: one that the session sets stands as it is."""
    kind = CATALOGUE.get(figure.name)
    if factor == 1 or kind is None or not kind.by_pixel or None in (kind.limit, figure.limit):
        return False
    return math.isclose(figure.limit, factor * kind.limit, rel_tol=1e-9)


def _footnote(inputs: ReportInputs, rows: list[_Row]) -> str:
    """What the mark beside scaled limits means; empty where none is scaled."""
    if not any(row.scaled for row in rows):
        return ""
    pixel_mm = _pixel_mm(inputs)
    return (
        f"* Limits of lengths are stated for pixels of up to {REFERENCE_PIXEL_MM:g} mm on the skin. Here a pixel covers"
        f" {pixel_mm:.2f} mm, so these limits are {limit_factor(pixel_mm):.2f} times as large."
    )


@dataclass(frozen=True)
class _Gate:
    """A limit and the worst figure held to it."""

    worst: _Row
    takes: int


def _gates(rows: list[_Row]) -> list[_Gate]:
    """One gate per figure that has a limit: its worst take."""
    held: dict[str, list[_Row]] = {}
    for row in rows:
        if row.figure.limit is not None:
            held.setdefault(row.figure.name, []).append(row)
    return [_Gate(max(group, key=_badness), len(group)) for group in held.values()]


def _badness(row: _Row) -> float:
    if row.figure.value is None:
        return float("inf")
    return row.figure.limit - row.figure.value if row.figure.at_least else row.figure.value - row.figure.limit


_EXPECTED = (
    ("reconstruct.error_median_mm", "half of the reconstructed points lie within {} mm of the skin"),
    ("reconstruct.completeness_1mm", "{} % of the skin that three cameras see has a point within 1 mm"),
    ("track.surface_error_median_mm", "half of the mesh's vertices lie within {} mm of the skin"),
    ("track.drift_median_mm", "half of them stay within {} mm of their place on the skin"),
    ("track.drift_p95_mm", "19 of 20 stay within {} mm of it"),
    ("track.lip_gap_error_mm", "the opening of the lips is off by {} mm (rms)"),
    ("calibrate.centre_error_mm", "camera positions are off by {} mm (rms)"),
    ("sync.offset_error_ms", "start times are off by {} ms (rms)"),
)


def _expectations(figures: tuple[Figure, ...]) -> list[str]:
    """What the figures against truth say about a rig, the worst take of each."""
    sentences = []
    for name, sentence in _EXPECTED:
        values = [figure.value for figure in figures if figure.name == name and figure.value is not None]
        if values:
            sentences.append(sentence.format(number(min(values) if CATALOGUE[name].at_least else max(values))))
    return sentences


def _summary(inputs: ReportInputs) -> list[Shown]:
    views = _liveliest(inputs)[:1]
    if not views:
        return []
    panels = pictures.frame_panels(views[0], inputs.register.template.triangles)
    return [photograph(panel) for panel in panels]


def _sync(take: TakeReport, inputs: ReportInputs) -> list[Shown]:
    image = diagrams.offsets_diagram(take.offsets, take.true_start_s, inputs.rate_hz)
    shown = [drawing(image, f"start times of {take.take}")]
    if take.sync_figure is not None:
        caption = "the clap in every camera's sound, and by how much each pair of cameras disagrees with the start times"
        shown.append(drawing(take.sync_figure, caption, 256))
    return shown


def _calibration(calibration: CalibrationReport, inputs: ReportInputs) -> list[Shown]:
    clouds = [view.cloud for take in inputs.takes for view in take.views if view.cloud is not None]
    limit = next((figure.limit for figure in inputs.figures if figure.name == "calibrate.heldout_rms_px"), None)
    rig = diagrams.rig_diagram(calibration.result.rig, clouds[0].positions if clouds else None)
    shown = [
        drawing(rig, "the cameras about the subject"),
        drawing(diagrams.heldout_diagram(calibration.result, limit), "held-out error by camera"),
    ]
    if calibration.detections:
        image = diagrams.coverage_diagram(calibration.detections)
        shown.append(drawing(image, "where in each image the board was seen"))
    boards = [pictures.board_overlay(picture) for picture in calibration.pictures]
    return shown + [photograph(board) for board in boards]


def _register(register: RegisterReport, inputs: ReportInputs) -> list[Shown]:
    panels = pictures.register_pictures(register)
    shown = [photograph(panel) for panel in panels]
    if register.error_mm is not None:
        image = diagrams.error_histogram(register.error_mm, _limits(inputs, "register"), title="Template to scan")
        shown.append(drawing(image, "template vertices to the scan's surface"))
    return shown


def _take(take: TakeReport, inputs: ReportInputs) -> tuple[list[list[Shown]], list[Shown]]:
    """Rows of frame pictures, and the diagrams over time."""
    rows, over_time = [], []
    template = inputs.register.template if inputs.register else None
    for view in take.views if template else ():
        panels = pictures.frame_panels(view, template.triangles)
        close_up = pictures.mouth_close_up(view, template)
        name = f"frame {view.frame}, {view.camera.name}: "
        rows.append([photograph(panel, name + panel.caption if i == 0 else None) for i, panel in enumerate(panels)])
        if close_up is not None:
            rows[-1].append(photograph(close_up, wide=True))
    if take.errors is not None and template is not None:
        caption = "against truth, frame by frame; dashed: limits of the take's median and 95th percentile"
        over_time.append(drawing(diagrams.error_curves(take.errors, _limits(inputs, "track")), caption))
        maps = pictures.error_over_time(take.errors, take.neutral, template.triangles)
        over_time += [photograph(panel) for panel in maps]
    if take.gaps is not None:
        over_time.append(drawing(diagrams.gap_curves(take.gaps), "without truth: points against the mesh"))
    if take.residuals is not None:
        caption = "without truth: what the tracker was left with in each frame"
        over_time.append(drawing(diagrams.residual_curves(take.residuals), caption))
    return rows, over_time


def _neck(inputs: ReportInputs) -> list[Shown]:
    captions = ("coefficients and errors over the takes", "coefficients fitted, and predicted from sound left out of training")
    return [drawing(image, caption, 256) for image, caption in zip(inputs.neck_pictures, captions, strict=False)]


def _limits(inputs: ReportInputs, stage: str) -> dict[str, float | None]:
    return {
        figure.name: figure.limit for figure in inputs.figures if figure.name.startswith(f"{stage}.error") or stage == "track"
    }
