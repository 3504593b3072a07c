"""The tracker: a textured template through all frames of a take.

Two passes. `track_anchors` follows the take from its first frame to its last at reduced resolution. `track_chunk` then refines
any range of frames at full resolution; each frame depends on the coarse trajectory and its own photographs alone, so chunks run
in parallel and meet without a seam. Both compare photographs with the fixed reference frame, never frame with frame; what that
frame hides (the inside of the lips) is added by keyframes (see `keyframes`).

Cameras do not fire together: each photograph is compared with the mesh at that photograph's own moment (see `coarse`, `fine`).
Section 4.2 of the neck paper; Li et al. 2009.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from headcap.cameras import Rig
from headcap.errors import InputError
from headcap.reconstruction.points import PointCloud
from headcap.registration.anchors import MARGIN, Anchors
from headcap.registration.coarse import CoarseState, CoarseTracker, Finish, lip_vertices
from headcap.registration.fine import FineTracker
from headcap.registration.keyframes import Keyframe, find_keyframe, with_keyframe
from headcap.registration.lips import LipTracker
from headcap.registration.motion import Trajectory
from headcap.registration.photographs import FrameSource, Photograph, resize, take_photographs
from headcap.registration.reference import Reference, build_reference, scaled_reference
from headcap.registration.template import Template
from headcap.registration.track_settings import TrackSettings

Clouds = Callable[[float], PointCloud | None]


def track_anchors(
    start: Template, rig: Rig, frames: FrameSource, clouds: Clouds | None, timeline_s: NDArray, settings: TrackSettings
) -> Anchors:
    """Follow the template from the take's first frame to its last at reduced resolution.

    `start` is the template at the first frame, in the world (from `prepare_start`); `timeline_s` (t,) are the frames' common
    times; `clouds` gives a frame's points by its time, or None.
    """
    times = np.asarray(timeline_s, float)
    if len(times) == 0:
        raise ValueError("a take without frames cannot be tracked")
    return _CoarsePass(start, _Reader(rig, frames, times, settings), clouds, settings).run()


def track_chunk(
    start: Template,
    anchors: Anchors,
    rig: Rig,
    frames: FrameSource,
    clouds: Clouds | None,
    first: int,
    last: int,
    settings: TrackSettings,
) -> tuple[NDArray[np.float32], dict[str, list[float]]]:
    """Refine frames `first` to `last` (inclusive) of a take at full resolution.

    Gives positions (last - first + 1, n, 3) float32 in metres and, per frame, the residuals left. `anchors` must hold these
    frames and their neighbours (`Anchors.load` sees to it).
    """
    reader = _Reader(rig, frames, anchors.time_s, settings)
    reference = scaled_reference(reader.reference(start, anchors.start_s), settings.fine_width_px)
    for keyframe in anchors.keyframes:
        reference = with_keyframe(reference, keyframe, reader.read(keyframe.time_s))
    tracker = FineTracker(reference, settings.photometric, settings.correspondence, settings.refine, settings.fine_refinements)
    positions, figures = [], []
    for number in range(first, last + 1):
        time_s = float(anchors.time_s[number - anchors.first])
        photographs = resize(reader.read(time_s), tracker.reference.cameras)
        cloud = clouds(time_s) if clouds is not None else None
        found, residuals = tracker.refine(anchors.frame(number), trajectory(anchors, number), photographs, cloud)
        positions.append(found.astype(np.float32))
        figures.append(residuals)
    return np.array(positions), {name: [frame[name] for frame in figures] for name in figures[0]}


def trajectory(anchors: Anchors, number: int) -> Trajectory:
    """Motion about a frame from up to two neighbours on either side in the coarse trajectory."""
    k = number - anchors.first
    around = slice(max(k - MARGIN, 0), k + MARGIN + 1)
    return Trajectory(anchors.time_s[around], anchors.positions[around].astype(float), k - around.start)


class _CoarsePass:
    """One run of the coarse pass over a take; its references grow as it finds keyframes."""

    def __init__(self, start: Template, reader: _Reader, clouds: Clouds | None, settings: TrackSettings) -> None:
        self.reader, self.clouds, self.settings = reader, clouds, settings
        self.full = reader.reference(start, reader.times_s[0])
        reference = scaled_reference(self.full, settings.coarse_width_px)
        self.tracker = CoarseTracker(reference, settings)
        self.lips = self._lip_tracker()
        priors = settings.correspondence, settings.refine
        self.polisher = FineTracker(reference, settings.coarse_photometric, *priors, 1)
        self.sharpener = FineTracker(self.full, settings.photometric, *priors, settings.fine_refinements)
        self.keyframes: list[Keyframe] = []

    def run(self) -> Anchors:
        """Every frame in turn; each is settled once the frame after it is known."""
        times = self.reader.times_s
        states, residuals = [self.tracker.start(times[0])], [0.0]
        positions, seen = [states[0].positions], [self._see(times[0])]
        for time_s in times[1:]:
            seen.append(self._see(time_s))
            earlier = states[-2] if len(states) > 1 else None
            finish = self._finish(seen[-1])
            state, figures = self.tracker.advance(states[-1], earlier, time_s, seen[-1].small, seen[-1].cloud, finish)
            states.append(state)
            residuals.append(figures["flow_residual_px"])
            if len(states) > 2:
                # with the frame after it known, a frame's motion is known on both sides
                states, seen = states[-MARGIN - 2 :], seen[-2:]
                positions.append(self._settle(states, seen[0]))
        if len(times) > 1:
            positions.append(states[-1].positions)
        return Anchors(0, times, np.array(positions, np.float32), np.array(residuals), float(times[0]), tuple(self.keyframes))

    def _see(self, time_s: float) -> _Seen:
        photographs = self.reader.read(time_s)
        small = resize(photographs, self.tracker.reference.cameras)
        return _Seen(photographs, small, self.clouds(time_s) if self.clouds is not None else None)

    def _lip_tracker(self) -> LipTracker | None:
        settings = self.settings
        if settings.lips.steps == 0 or lip_vertices(self.full.template) is None:
            return None
        reference = scaled_reference(self.full, settings.fine_width_px)
        return LipTracker(reference, settings.lips, settings.correspondence, settings.refine)

    def _finish(self, seen: _Seen) -> Finish | None:
        """What ends a frame at full resolution."""
        if self.lips is None:
            return None
        photographs = resize(seen.photographs, self.lips.cameras)
        return lambda positions, motion: self.lips.refine(positions, motion, photographs, seen.cloud)

    def _settle(self, states: list[CoarseState], seen: _Seen) -> NDArray:
        """Polished positions (n, 3) of the last state but one; it may become a keyframe."""
        motion = _through(states)
        positions = self.polisher.refine(states[-2].positions, motion, seen.small, seen.cloud)[0]
        finish = self._finish(seen)
        if finish is not None:
            positions = finish(positions, motion)
        if seen.cloud is not None and len(self.keyframes) < self.settings.keyframes.most:
            self._grow(states[-2].time_s, positions, motion, seen)
        return positions

    def _grow(self, time_s: float, positions: NDArray, motion: Trajectory, seen: _Seen) -> None:
        photographs, cloud, settings = seen.photographs, seen.cloud, self.settings.keyframes
        if find_keyframe(self.full, time_s, positions, motion, photographs, cloud, settings) is None:
            return
        sharp = self.sharpener.refine(positions, motion, photographs, cloud)[0]
        keyframe = find_keyframe(self.full, time_s, sharp, motion, photographs, cloud, settings)
        if keyframe is not None:
            self._add(keyframe, photographs)

    def _add(self, keyframe: Keyframe, photographs: list[Photograph]) -> None:
        self.keyframes.append(keyframe)
        self.full = with_keyframe(self.full, keyframe, photographs)
        reference = with_keyframe(self.tracker.reference, keyframe, photographs)
        self.tracker.reference = self.polisher.reference = reference
        self.sharpener.reference = self.full
        if self.lips is not None:
            self.lips.show(scaled_reference(self.full, self.settings.fine_width_px))


@dataclass(frozen=True)
class _Seen:
    """What there is of one frame."""

    photographs: list[Photograph]
    small: list[Photograph]
    """The same at the coarse pass's resolution."""
    cloud: PointCloud | None


class _Reader:
    """Photographs by time, and the reference they are compared with."""

    def __init__(self, rig: Rig, frames: FrameSource, times_s: NDArray, settings: TrackSettings) -> None:
        self.rig, self.frames, self.times_s, self.settings = rig, frames, times_s, settings
        step_s = float(np.median(np.diff(times_s))) if len(times_s) > 1 else np.inf
        self.gap_s = settings.time_gap_frames * step_s

    def read(self, time_s: float) -> list[Photograph]:
        """All cameras' photographs near a moment."""
        smoothing = self.settings.photometric.smoothing_px
        found = take_photographs(self.frames, self.rig, time_s, gap_s=self.gap_s, smoothing_px=smoothing)
        if not found:
            raise InputError(
                f"no camera has a photograph within {1e3 * self.gap_s:.0f} ms of {time_s:.3f} s",
                expected="at least one",
                remedy="Shorten the take in the session file or check the time offsets.",
            )
        return found

    def reference(self, start: Template, first_s: float) -> Reference:
        """The template tied to the photographs of the take's first frame."""
        photographs = {photograph.camera: photograph.image for photograph in self.read(first_s)}
        images = [photographs.get(c) for c in range(len(self.rig))]
        own = self.settings.reference == "own_photograph"
        return build_reference(start, self.rig, images, own_photographs=own, edge_margin_px=self.settings.edge_margin_px)


def _through(states: list[CoarseState]) -> Trajectory:
    """About the last state but one."""
    return Trajectory(np.array([state.time_s for state in states]), np.array([s.positions for s in states]), len(states) - 2)
