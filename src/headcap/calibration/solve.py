"""From board detections of all cameras to the calibrated rig."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from headcap.calibration.board import BoardSettings
from headcap.calibration.corners import BoardView
from headcap.calibration.detection import CameraDetections
from headcap.calibration.gauge import canonical_frame
from headcap.calibration.grouping import BoardPose, cell_count, group_poses, image_cells
from headcap.calibration.heldout import HeldOut, measure_heldout, solve_board_pose, split_poses
from headcap.calibration.intrinsics import Lens, start_lens
from headcap.calibration.polish import lens_alone, polish
from headcap.calibration.result import CalibrationResult, CameraFigures, SolvedPose
from headcap.calibration.rig import Adjusted, adjust_rig
from headcap.calibration.settings import CalibrateSettings, RigSettings
from headcap.calibration.start import start_poses
from headcap.calibration.timing import VisualTiming, moving_enough, trusted, try_motion, visual_timing
from headcap.errors import InputError, InputErrors
from headcap.sync.offsets import TimeOffsets

Array = NDArray[np.float64]


def calibrate(
    detections: Sequence[CameraDetections],
    offsets: TimeOffsets,
    board: BoardSettings,
    settings: CalibrateSettings,
    *,
    known_lenses: Mapping[str, Lens] | None = None,
) -> CalibrationResult:
    """Calibrate all cameras of a session from one recording of a board.

    Board poses are grouped over cameras by the common time of `offsets`; the rig is first fitted without the held-out
    poses, which measure it, and then with all. Sightings of the moving board refine it and give each camera's time offset
    where they fit as well as still ones do. Where some camera saw the board in few places of its image, lenses come from
    each camera's own views and stay. The result is in the rig's canonical frame (`gauge`). Raises `InputErrors`
    or `InputError` that name cameras which cannot be solved; gates are `result.check_gates`.
    """
    seen = {d.camera: d for d in detections}
    known = dict(known_lenses or {})
    poses = group_poses(seen, offsets, settings.group)
    lenses = _start_lenses(seen, poses, board.corners, known)
    camera_from_rig, rig_from_board = start_poses(poses, lenses, board.corners, tuple(seen))
    kept = frozenset(known) if settings.rig.keep_known_intrinsics else frozenset()
    if not _covered(poses, seen, settings.rig):
        alone = {name: lens_alone(name, lenses[name], _views(seen[name]), board.corners) for name in seen if name not in kept}
        lenses, kept = {**lenses, **alone}, frozenset(seen)
        camera_from_rig, rig_from_board = start_poses(poses, lenses, board.corners, tuple(seen))
    fit, held = split_poses(poses, settings.rig.heldout_share)
    moving = moving_enough(detections, settings.timing)
    problem = _Problem(detections, offsets, board, settings, kept, moving)
    trial, _ = problem.solve(
        [poses[i] for i in fit],
        lenses,
        camera_from_rig,
        [rig_from_board[i] for i in fit],
        without=[poses[i].time_s for i in held],
    )
    heldout = measure_heldout(trial.rig, [poses[i] for i in held], board.corners)
    final, timing = problem.solve(poses, lenses, camera_from_rig, rig_from_board)
    return _result(final, heldout, len(held), seen, timing)


@dataclass(frozen=True)
class _Problem:
    """What stays the same between the trial without held-out poses and the final adjustment."""

    detections: Sequence[CameraDetections]
    offsets: TimeOffsets
    board: BoardSettings
    settings: CalibrateSettings
    constant_lenses: frozenset[str]
    moving: bool

    def solve(
        self,
        poses: Sequence[BoardPose],
        lenses: Mapping[str, Lens],
        camera_from_rig: Mapping[str, Array],
        rig_from_board: Sequence[Array],
        *,
        without: Sequence[float] = (),
    ) -> tuple[Adjusted, VisualTiming | None]:
        """Still poses first; then the board's whole motion, where it fits as well as the still poses do."""
        corners, rig_settings = self.board.corners, self.settings.rig
        adjusted = adjust_rig(
            poses,
            corners,
            lenses,
            camera_from_rig,
            rig_from_board,
            rig_settings,
            constant_lenses=self.constant_lenses,
        )
        adjusted = polish(adjusted, corners, self.constant_lenses)
        if not self.moving:
            return adjusted, None
        # a held-out pose is left out with all that was seen of it: the board may have been still for longer
        reach = 2 * self.settings.group.window_s
        fit = try_motion(
            adjusted.rig,
            self.detections,
            self.offsets,
            self.board,
            self.settings.timing,
            free_cameras=True,
            constant_lenses=self.constant_lenses,
            without_s=[(time - reach, time + reach) for time in without],
        )
        if fit is None or not trusted(fit, self.settings.timing):
            return adjusted, None
        solved = [(pose, solve_board_pose(fit.rig, pose, corners)) for pose in adjusted.poses]
        # of a pose with few corners left the search may run away: it has helped the rig, and tells nothing beside it
        told = [(pose, world_from_board) for pose, world_from_board in solved if np.isfinite(world_from_board).all()]
        still = replace(adjusted, rig=fit.rig, poses=tuple(p for p, _ in told), world_from_board=tuple(w for _, w in told))
        return still, visual_timing(fit)


def _covered(poses: Sequence[BoardPose], seen: Mapping[str, CameraDetections], settings: RigSettings) -> bool:
    """Whether the board was all over the images of every camera, so that lenses and poses can be told together."""
    shares = [
        _coverage(np.concatenate([np.empty((0, 2)), *(p.views[name].pixels for p in poses if name in p.views)]), detections)
        for name, detections in seen.items()
    ]
    return min(shares) >= settings.bend_coverage


def _views(detections: CameraDetections) -> list[BoardView]:
    return [detections.view(i) for i in range(len(detections))]


def _coverage(pixels: Array, seen: CameraDetections) -> float:
    """Share of the image's cells in which pixels (n, 2) lie."""
    return len(np.unique(image_cells(pixels, seen.width, seen.height))) / cell_count(seen.width, seen.height)


def _start_lenses(
    seen: Mapping[str, CameraDetections], poses: Sequence[BoardPose], corners: Array, known: Mapping[str, Lens]
) -> dict[str, Lens]:
    lenses, errors = dict(known), []
    for name, detections in seen.items():
        if name in known:
            continue
        views = [pose.views[name] for pose in poses if name in pose.views]
        try:
            lenses[name] = start_lens(name, (detections.width, detections.height), views, corners)
        except InputError as error:
            errors.append(error)
    if errors:
        raise InputErrors(errors)
    return lenses


def _result(
    final: Adjusted, heldout: HeldOut, held: int, seen: Mapping[str, CameraDetections], timing: VisualTiming | None
) -> CalibrationResult:
    canonical_from_rig = canonical_frame(final.rig)
    return CalibrationResult(
        rig=final.rig.transformed(canonical_from_rig),
        cameras=tuple(_camera_figures(name, final, heldout, seen[name], timing) for name in final.rig.names),
        heldout_rms_px=heldout.rms_px(),
        heldout_p95_px=heldout.p95_px(),
        board_scale_error_mm=heldout.board_scale_error_mm(),
        heldout_poses=held,
        poses=tuple(
            SolvedPose(pose.time_s, canonical_from_rig @ rig_from_board, dict(pose.frames))
            for pose, rig_from_board in zip(final.poses, final.world_from_board, strict=True)
        ),
    )


def _camera_figures(
    name: str, final: Adjusted, heldout: HeldOut, seen: CameraDetections, timing: VisualTiming | None
) -> CameraFigures:
    views = [pose.views[name] for pose in final.poses if name in pose.views]
    pixels = np.concatenate([v.pixels for v in views] or [np.empty((0, 2))])
    return CameraFigures(
        camera=name,
        heldout_rms_px=_or_none(heldout.rms_px(name)),
        heldout_p95_px=_or_none(heldout.p95_px(name)),
        coverage=_coverage(pixels, seen),
        poses=len(views),
        corners=len(pixels),
        rejected=final.rejected[name],
        av_offset_s=None if timing is None else timing.av_offset_s[timing.cameras.index(name)],
        av_offset_sigma_s=None if timing is None else timing.sigma_s[timing.cameras.index(name)],
    )


def _or_none(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
