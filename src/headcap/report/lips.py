"""The page of a study's lips: tables 1 to 3 of the lip paper with intervals over takes, and its figures 5 and 14 to 16."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from headcap.evaluation.lips_study import ALL, LipRow, LipStudy
from headcap.evaluation.metrics import load_metrics
from headcap.report import lips_figures as diagrams
from headcap.report.overlays import load_image
from headcap.report.page import Shown, drawing, write_page
from headcap.report.provenance import PageFoot

_INPUTS_OF = ("GR", "MS", "PS")
"""Whose tables 2 and 3 are shown: the first that has baselines."""


@dataclass(frozen=True)
class LipFiles:
    """Where everything lies that a study made of lips."""

    tables: Path
    figures: Path
    maps: tuple[Path, ...]
    """Of each person."""
    comparisons: tuple[Path, ...]
    curves: tuple[Path, ...]
    inpainted: tuple[Path, ...]
    """Figure 5 of each tattooed take of a rig."""
    sheets: tuple[Path, ...]
    """Frames with what the base tracker makes of them, of each take."""

    @property
    def all(self) -> list[Path]:
        """Every file that is read."""
        return [self.tables, self.figures, *self.maps, *self.comparisons, *self.curves, *self.inpainted, *self.sheets]


def write_lips_report(files: LipFiles, people: Mapping[str, str], settings: Mapping, path: Path | str) -> None:
    """Write the page as one HTML file; `people` says of each whose takes were tested what they were to the study."""
    study = LipStudy.load(files.tables)
    inputs = PageFoot.of(load_metrics(files.figures), {path.name: path for path in (files.tables, files.figures)}, settings)
    told = next((relation for relation in _INPUTS_OF if len(study.by_inputs(relation)) > 1), None)
    write_page(
        path,
        "lips.html.j2",
        inputs,
        study=study,
        people=dict(people),
        past=[figure for figure in inputs.figures if figure.ok is False],
        scopes=[(scope, _rows(study, scope)) for scope in dict.fromkeys(row.scope for row in study.rows)],
        differences=[row for row in study.differences if row.scope == ALL],
        table_1=drawing(diagrams.error_bars(study), "Table 1 as bars, intervals over takes; the paper's in grey"),
        tables_2_3=drawing(diagrams.input_bars(study, told), "Tables 2 and 3, and the affine regressor") if told else None,
        persons=[(name, _shown(files, number)) for number, name in enumerate(people)],
        inpainted=[_drawn(picture, f"Figure 5: {picture.parents[1].name}, {picture.stem}") for picture in files.inpainted],
        sheets=[_drawn(sheet, f"Base tracker: {sheet.parent.name}, {sheet.stem}") for sheet in files.sheets],
    )


def _rows(study: LipStudy, scope: str) -> list[LipRow]:
    return [row for row in study.rows if row.scope == scope]


def _shown(files: LipFiles, number: int) -> list[Shown]:
    return [
        _drawn(files.maps[number], "Figure 15: mean error of each vertex about the mouth, mm"),
        _drawn(files.comparisons[number], "Figure 14: the same moments, tracked by one camera, corrected, true"),
        _drawn(files.curves[number], "Distance between the lips, and how far they are rolled out, over the take"),
    ]


def _drawn(path: Path, caption: str) -> Shown:
    return drawing(load_image(path), caption)
