"""The figures by name: unit, default limit, which side of it is good, and what the figure means."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class FigureKind:
    """One row of the table of figures."""

    unit: str
    meaning: str
    limit: float | None = None
    """None: the figure is stated, not held to a limit."""
    at_least: bool = False
    """True where more is better."""
    needs_truth: bool = True
    by_pixel: bool = False
    """A length measured in photographs: its limit grows with the pixel on the skin, see `limit_factor`."""


REFERENCE_PIXEL_MM = 0.46
"""Size of a pixel on the skin (`rig.pixel_mm`) up to which the default limits of lengths hold as they stand."""


def limit_factor(pixel_mm: float | None) -> float:
    """By what the default limits of lengths measured in photographs are multiplied: max(1, pixel / reference pixel).

    Errors in pixels do not depend on the resolution, so lengths grow with the pixel. A finer pixel than the reference
    tightens nothing: below it the optics and the skin decide. 1 where the pixel's size is not known.
    """
    if pixel_mm is None or not math.isfinite(pixel_mm):
        return 1.0
    return max(1.0, pixel_mm / REFERENCE_PIXEL_MM)


def _stated(unit: str, meaning: str, limit: float | None = None, **more: bool) -> FigureKind:
    return FigureKind(unit, meaning, limit, needs_truth=False, **more)


def _length(meaning: str, limit: float | None = None, **more: bool) -> FigureKind:
    return FigureKind("mm", meaning, limit, by_pixel=True, **more)


_MATERIAL = "tied at the reference frame to the true surface; later the distance to where that material point has gone"

CATALOGUE: dict[str, FigureKind] = {
    "rig.pixel_mm": _stated("mm", "edge of a pixel on the face, median over cameras"),
    "sync.offset_error_ms": FigureKind("ms", "start times against the true ones, common mean taken out, rms", 0.1),
    "sync.confidence_min": _stated(
        "", "share of the other cameras that agree with a camera about the clap, least", at_least=True
    ),
    "sync.pair_residual_median_ms": _stated("ms", "disagreement of the pairwise delays with the solved start times, median"),
    "sync.pair_residual_p95_ms": _stated(
        "ms", "disagreement of the pairwise delays with the solved start times, 95th percentile"
    ),
    "sync.flight_spread_ms": _stated("ms", "time of flight of the clap that was taken off, largest minus smallest"),
    "sync.drift_max_ppm": _stated("ppm", "drift of a camera's clock, largest; measured where there are two claps"),
    "calibrate.heldout_rms_px": _stated("px", "board corners in poses left out of the adjustment, rms", 0.15),
    "calibrate.heldout_p95_px": _stated("px", "board corners in poses left out of the adjustment, 95th percentile"),
    "calibrate.board_scale_error_mm": _stated("mm", "distances between triangulated held-out corners against the board, rms"),
    "calibrate.coverage": _stated(
        "", "share of the image's cells in which the board was seen, of the worst camera", at_least=True
    ),
    "calibrate.poses": _stated("", "poses of the board in the adjustment, of the worst camera", at_least=True),
    "calibrate.bump_residual_px": _stated("px", "the take's pictures against the rig of the board's recording, worst camera"),
    "calibrate.centre_error_mm": _length("camera centres after one rigid alignment, rms", 0.3),
    "calibrate.rotation_error_deg": FigureKind("deg", "camera rotations after the same alignment, rms", 0.03),
    "reconstruct.error_median_mm": _length("points to the true surface at that time, median", 0.09),
    "reconstruct.error_p90_mm": _length("points to the true surface at that time, 90th percentile", 0.3),
    "reconstruct.completeness_half_mm": FigureKind("%", "true surface seen by 3 cameras with a point within 0.5 mm", 75.0, True),
    "reconstruct.completeness_1mm": FigureKind("%", "true surface seen by 3 cameras with a point within 1 mm", 94.0, True),
    "reconstruct.completeness_half_mm_recording": _stated(
        "%", "the same within 0.5 mm, counting only cameras that were recording", at_least=True
    ),
    "reconstruct.completeness_1mm_recording": _stated(
        "%", "the same within 1 mm, counting only cameras that were recording", at_least=True
    ),
    "reconstruct.points": _stated("", "points per frame, median", at_least=True),
    "register.error_median_mm": _stated("mm", "template vertices to the scan's surface, median", 0.15),
    "register.error_p95_mm": _stated("mm", "template vertices to the scan's surface, 95th percentile", 0.6),
    "register.flipped_triangles": _stated("", "triangles of the template turned by more than 90 degrees against all around them"),
    "register.coverage_pct": _stated("%", "vertices that have a counterpart on the scan", at_least=True),
    "register.align_score_mm": _stated("mm", "the generic head on the scan before it was bent"),
    "register.scale": _stated("", "size of the scan beside the generic head"),
    "register.lip_line_strength": _stated("", "how clearly the scan shows the line between the lips; 0: it does not"),
    "place.error_median_mm": _stated("mm", "first cloud to the template placed on it, kept points, median"),
    "place.error_p90_mm": _stated("mm", "first cloud to the template placed on it, kept points, 90th percentile"),
    "place.within_2mm_pct": _stated("%", "points of the first cloud within 2 mm of the template placed on it", at_least=True),
    "track.surface_error_median_mm": _length("seen template vertices to the true surface, all frames, median", 0.12),
    "track.surface_error_p95_mm": _length("seen template vertices to the true surface, 95th percentile", 0.5),
    "track.drift_median_mm": _length(f"seen template vertices {_MATERIAL}, median", 0.15),
    "track.drift_p95_mm": _length(f"seen template vertices {_MATERIAL}, 95th percentile", 0.8),
    "track.drift_all_median_mm": _length(f"all template vertices, seen or not, {_MATERIAL}, median"),
    "track.drift_all_p95_mm": _length(f"all template vertices, seen or not, {_MATERIAL}, 95th percentile"),
    "track.lip_gap_error_mm": _length("distance between upper and lower inner-lip material points, rms error", 0.5),
    "track.cloud_distance_median_mm": _length("reconstructed points to the tracked mesh, median", needs_truth=False),
    "track.surface_flow_residual": _stated("", "what photographs and textured mesh still differ by, worst frame"),
    "track.last_step_mm": _stated("mm", "rms step of the vertices in the last refinement, worst frame"),
    "neck.larynx_correlation": FigureKind("", "slide of the fitted larynx with the height of the true one, Pearson", 0.8, True),
    "neck.larynx_correlation_of_meshes": FigureKind(
        "", "the same for a subject that entered the study as meshes, which no tracker has blurred", 0.95, True
    ),
    "neck.base_error_mm": _stated("mm", "neck with the head model before training, speech takes, mean over vertices and frames"),
    "neck.error_mm": _stated(
        "mm", "the same with the whole neck model: larynx, speech blendshapes, pose correctives, expressions"
    ),
    "neck.pose_error_drop_mm": _stated(
        "mm", "what trained pose correctives take off the neck's error in pose takes", 0.0, at_least=True
    ),
    "neck.expression_error_drop_mm": _stated(
        "mm", "what trained pose correctives and expressions take off it in expression takes", 0.0, at_least=True
    ),
    "neck.speech_error_drop_mm": _stated(
        "mm", "what larynx and speech blendshapes take off it in speech takes", 0.0, at_least=True
    ),
    "neck.larynx_part_mm": _stated("mm", "by how much the error grows with the larynx held at rest", 0.0, at_least=True),
    "neck.speech_part_mm": _stated("mm", "by how much the error grows without speech blendshapes", 0.0, at_least=True),
    "neck.skipped_frames": _stated("", "frames whose mesh was not finite, left aside"),
    "neck.slide_range_mm": _stated("mm", "how far the larynx slid, 5th to 95th percentile"),
    "lips.base_error_mm": _stated("mm", "mouth of the base tracker to the true one, mean over vertices and frames"),
    "lips.contour_error_mm": _stated("mm", "the same of the contour-based tracker with a person's own lip blendshapes"),
    "lips.error_mm": _stated(
        "mm", "the same as a user gets it, corrected by a regressor that never saw the person where there is one"
    ),
    "lips.ps_error_mm": _stated("mm", "the same, corrected by a regressor of that person alone"),
    "lips.ms_error_mm": _stated("mm", "the same, corrected by a regressor of several persons, this one among them"),
    "lips.gr_error_mm": _stated("mm", "the same, corrected by a regressor that never saw the person"),
    "lips.ps_error_drop_pct": FigureKind("%", "what a person's own regressor takes off the base tracker's error", 30.0, True),
    "lips.ms_error_drop_pct": FigureKind("%", "what a regressor of several persons takes off it", 30.0, True),
    "lips.gr_error_drop_pct": FigureKind("%", "what a regressor that never saw the person takes off it", 25.0, True),
    "lips.gr_reprojected_error_mm": _stated("mm", "the same, its contours constraints, as headcap lips corrects"),
    "lips.gr_reprojected_error_drop_pct": FigureKind("%", "what that takes off the base tracker's error", 25.0, True),
    "lips.base_shape_error_mm": _stated(
        "mm", "base tracker's mouth after one more rigid alignment, of the mouth alone: its shape"
    ),
    "lips.shape_error_mm": _stated("mm", "the same, corrected"),
    "lips.shape_error_drop_pct": _stated("%", "what the correction takes off it", at_least=True),
    "lips.base_gap_error_mm": _stated("mm", "distance between the lips of the base tracker, rms error"),
    "lips.gap_error_mm": _stated("mm", "the same, corrected"),
    "lips.base_roll_error_deg": _stated("deg", "how far the lips' cross-sections are rolled in or out, base tracker, mean error"),
    "lips.roll_error_deg": _stated("deg", "the same, corrected"),
    "lips.base_unanswered_frames": _stated("", "frames with truth in which the base tracker had lost the face"),
    "lips.unanswered_frames": _stated("", "frames with truth that were not corrected; they enter no mean"),
    "lips.lost_frames": _stated("", "frames of a video in which the base tracker had lost the face"),
    "lips.uncorrected_frames": _stated("", "frames of a video with a face whose lips were not corrected"),
    "lips.photometric_residual": _stated(
        "", "picture less rendering where they agree, rms per channel of linear intensity 0 to 1, median over frames"
    ),
    "lips.base_outer_contour_px": _stated("px", "the base tracker's outer lip contour to the one found in the picture, mean"),
    "lips.outer_contour_px": _stated("px", "the same, corrected"),
    "lips.base_inner_contour_px": _stated("px", "the base tracker's inner lip contour to the one found in the picture, mean"),
    "lips.inner_contour_px": _stated("px", "the same, corrected"),
    "lips.base_closures_shown_pct": _stated(
        "%", "b, p and m at which the base tracker's lip gap has a shut minimum", at_least=True
    ),
    "lips.base_closures_by_chance_pct": _stated("%", "moments of the same speech that have one near"),
    "lips.closures_shown_pct": _stated("%", "b, p and m at which the corrected lip gap has a shut minimum", at_least=True),
    "lips.closures_by_chance_pct": _stated("%", "moments of the same speech that have one near"),
    "quasi_eigen.alpha_hand_pct": _stated(
        "%", "hand-made basis: error of reproducing the performance over the size of the face about its centroid (eq. 6)"
    ),
    "quasi_eigen.alpha_pca_pct": _stated("%", "the same of the mean and as many eigenfaces as the bases are compared at"),
    "quasi_eigen.alpha_qe_pct": _stated("%", "the same of the quasi-eigen faces, all of them"),
    "quasi_eigen.alpha_qe_chosen_pct": _stated(
        "%", "the same of as many quasi-eigen faces as there are eigenfaces, chosen greedily"
    ),
    "quasi_eigen.qe_over_pca": _stated("", "error of the quasi-eigen faces over that of the eigenfaces they were made of", 1.2),
    "quasi_eigen.qe_over_pca_beside_mean": _stated("", "the same where the mean comes beside as many eigenfaces as shapes"),
    "quasi_eigen.qe_chosen_over_pca": _stated("", "the same of as many quasi-eigen faces as there are eigenfaces"),
    "quasi_eigen.hand_over_qe": _stated(
        "", "error of the hand-made shapes over that of the quasi-eigen faces made of them", 4.0, at_least=True
    ),
    "quasi_eigen.displacement_hand_pct": _stated("%", "error of the hand-made basis over the motion away from the neutral face"),
    "quasi_eigen.displacement_pca_pct": _stated("%", "the same of the eigenfaces"),
    "quasi_eigen.displacement_qe_pct": _stated("%", "the same of the quasi-eigen faces"),
    "quasi_eigen.rms_hand_mm": _stated("mm", "reproduced to performed point, rms over points and frames, hand-made basis"),
    "quasi_eigen.rms_pca_mm": _stated("mm", "the same of the eigenfaces"),
    "quasi_eigen.rms_qe_mm": _stated("mm", "the same of the quasi-eigen faces"),
    "quasi_eigen.elements": _stated("", "eigenfaces beside the mean at which bases are compared: one fewer than shapes, or all"),
    "quasi_eigen.median_correlation": _stated(
        "", "quasi-eigen faces with their own hand-made shapes, cosine, median over shapes exercised", 0.8, at_least=True
    ),
    "quasi_eigen.own_closest_share": _stated(
        "", "exercised shapes whose quasi-eigen face is closer to its own hand-made shape than to any other", at_least=True
    ),
    "quasi_eigen.not_exercised": _stated(
        "", "shapes that keep less than a third of their norm: the performance does not do them"
    ),
    "quasi_eigen.not_told_apart": _stated(
        "", "shapes that keep a third of their norm but not of what is theirs alone: the performance does others like them"
    ),
    "quasi_eigen.missing_axes": _stated("", "eigenfaces that the hand-made shapes leave out"),
    "quasi_eigen.mean_outside": _stated("", "share of the mean face outside the eigenfaces, which eq. 4 adds to every shape"),
    "speech.phi_error": _stated("mm", "weights of the speech blendshapes from sound left out of training, mean length of error"),
    "speech.phi_error_of_mean": _stated("mm", "the same of predicting the mean of the frames trained on"),
    "speech.tau_error": _stated("mm2", "slide of the larynx from sound left out of training, mean squared error"),
    "speech.tau_error_of_mean": _stated("mm2", "the same of predicting the mean of the frames trained on"),
    "speech.alpha_error": _stated("", "scale of the larynx from sound left out of training, mean squared error"),
    "speech.alpha_error_of_mean": _stated("", "the same of predicting the mean of the frames trained on"),
    "speech.shared_sound_share": _stated(
        "", "frames left out whose 0.52 s of sound frames trained on share: one take cut up; errors are then too small"
    ),
    "speech.takes": _stated("", "takes with a voice; of a single one, stretches are left out instead", at_least=True),
    "speech.frames": _stated("", "fitted frames that the regressors were trained on", at_least=True),
    "speech.skipped_frames": _stated("", "frames without coefficients, left aside"),
    "speech.clarity_db": _stated("dB", "loud over quiet moments of a speech take, clearest microphone", at_least=True),
    "speech.voiced_share": _stated("", "sound that has a pitch; without any, loudness alone drives the larynx", at_least=True),
    "track.flipped_triangles": _stated("", "triangles turned by more than 90 degrees against all around them, worst frame"),
}


def unit_of(name: str) -> str:
    """The unit of a figure: from the catalogue, else from the suffix of its name."""
    if name in CATALOGUE:
        return CATALOGUE[name].unit
    suffix = name.rsplit("_", 1)[-1]
    return {"pct": "%", "ppm": "ppm"}.get(suffix, suffix if suffix in ("mm", "px", "ms", "deg", "s", "hz", "m") else "")
