"""`headcap lip-errors`: what `headcap lips` made of a video, against the true meshes of the face in it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from headcap.artifacts import digest_settings, write_manifest
from headcap.calibration.result import load_camera
from headcap.errors import InputError
from headcap.evaluation.lip_errors import LipErrors
from headcap.evaluation.lip_truth import TrueMeshes, judge_against
from headcap.evaluation.lips_study import DELIVERED
from headcap.evaluation.truth import Truth
from headcap.lips.contours import ContourSequence
from headcap.lips.kit import LipKit
from headcap.lips.monocular import MonocularTrack
from headcap.lips.takes import SeenTake
from headcap.lips.training import regressed
from headcap.registration.sequence import MeshSequence
from headcap.registration.template import Template

GR, HELD = "GR", DELIVERED
ERRORS = "errors.npz"


@dataclass(frozen=True)
class TruthRequest:
    """What `headcap lip-errors` was asked for."""

    results: Path
    """Folder that `headcap lips` wrote."""
    kit: Path
    """The kit it was given."""
    truth: Path
    """sequence.json of meshes frame by frame, or a take's .npz in a truth folder."""
    template: Path | None = None
    """Triangles, landmarks and face at rest of a sequence."""
    camera_name: str | None = None
    """Of a truth folder's cameras, the one that took the video; by default the one that tracked it."""


def judge_lips(request: TruthRequest) -> tuple[LipErrors, list[str]]:
    """Write `errors.npz` beside a video's results, and return it with a table for a reader.

    Raises `InputError` for a truth of other frames, cameras or topology, and `ArtifactError` for files of another kind.
    """
    kit, camera = LipKit.load(request.kit), load_camera(request.results / "camera.json")
    track = MonocularTrack.load(request.results / "track.npz")
    contours = ContourSequence.load(request.results / "contours.npz")
    seen = SeenTake.of(kit.space, track, camera, contours.contours())
    parameters = regressed(kit.regressor, {"clip": seen})["clip"]
    identity = kit.regressor.identity
    corrected = {
        GR: seen.corrected(parameters, identity=identity),
        HELD: MeshSequence.load(request.results / "corrected.json").positions(),
    }
    true = _true_meshes(request, camera.name, track.time_s)
    errors = judge_against(kit.space, seen, corrected, true, track.time_s, person="", take=request.truth.stem)
    _save(request, errors)
    return errors, table(errors)


def table(errors: LipErrors) -> list[str]:
    """Rows of a reader's table: means over the frames that all methods answered, mm and degrees."""
    common, known = errors.common, int(errors.truth_known.sum())
    if not common.any():
        raise InputError(
            f"{known} frames with truth, none of them corrected",
            expected="one frame at least that was corrected and has a truth",
            remedy="Check that the truth is that of this video.",
        )
    lines = [
        f"{int(common.sum())} of {known} frames with truth were corrected; means over these, in the truth's mm",
        f"{'':16}{'error':>8}{'shape':>8}{'gap':>8}{'roll':>8}",
    ]
    for row, method in enumerate(errors.methods):
        gap = errors.gap_mm[row] - errors.gap_mm[-1]
        means = (
            errors.error_mm[row][common].mean(),
            errors.shape_error_mm[row][common].mean(),
            float(np.sqrt(np.mean(gap[common] ** 2))),
            errors.roll_error_deg[row][common].mean(),
        )
        lines.append(f"{method:16}" + "".join(f"{value:8.2f}" for value in means) + " deg")
    return lines


def _true_meshes(request: TruthRequest, camera: str, time_s: np.ndarray) -> TrueMeshes:
    if request.truth.suffix == ".npz":
        truth = Truth(request.truth.parent)
        return TrueMeshes.of_rig(truth, request.truth.stem, request.camera_name or camera, time_s)
    if request.template is None:
        raise InputError(
            f"true meshes {request.truth} without a template",
            expected="the template .npz that tells their triangles, landmarks and the face at rest",
            remedy="Give it with --template.",
        )
    return TrueMeshes.of_sequence(MeshSequence.load(request.truth), Template.load(request.template), len(time_s))


def _save(request: TruthRequest, errors: LipErrors) -> None:
    path, common = request.results / ERRORS, errors.common
    errors.save(path)
    given = (request.results / "track.npz", request.results / "corrected.json", request.kit, request.truth, request.template)
    write_manifest(
        path,
        kind="lip_errors",
        stage="lips",
        settings_digest=digest_settings(camera=request.camera_name),
        inputs=[one for one in given if one is not None],
        figures={
            f"lips.{method.replace(' ', '_')}_error_mm": float(errors.error_mm[row][common].mean())
            for row, method in enumerate(errors.methods)
            if common.any()
        },
    )
