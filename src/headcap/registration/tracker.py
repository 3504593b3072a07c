"""The tracker: a textured template through all frames of a take.

Two passes. `track_anchors` follows the take from its first frame to its last at reduced resolution. `track_chunk` then refines
any range of frames at full resolution; each frame depends on the coarse trajectory and its own photographs alone, so chunks run
in parallel and meet without a seam. Both compare photographs with the fixed reference frame, never frame with frame.

Cameras do not fire together: each photograph is compared with the mesh at that photograph's own moment (see `coarse`, `fine`).
Section 4.2 of the neck paper; Li et al. 2009.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from headcap.cameras import Rig
from headcap.errors import InputError
from headcap.reconstruction.points import PointCloud
from headcap.registration.anchors import MARGIN, Anchors
from headcap.registration.coarse import CoarseState, CoarseTracker
from headcap.registration.fine import FineTracker, Trajectory
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
    reader = _Reader(rig, frames, times, settings)
    reference = scaled_reference(reader.reference(start, times[0]), settings.coarse_width_px)
    tracker, polisher = (
        CoarseTracker(reference, settings),
        FineTracker(reference, settings.coarse_photometric, settings.correspondence, settings.refine, 1),
    )
    states, positions, residuals = [tracker.start(times[0])], [start.vertices], [0.0]
    held = [(resize(reader.read(times[0]), reference.cameras), None)]
    for time_s in times[1:]:
        held.append((resize(reader.read(time_s), reference.cameras), clouds(time_s) if clouds is not None else None))
        earlier = states[-2] if len(states) > 1 else None
        state, figures = tracker.advance(states[-1], earlier, time_s, *held[-1])
        states.append(state)
        residuals.append(figures["flow_residual_px"])
        if len(states) > 2:
            # with the frame after it known, a frame's motion is known on both sides
            states, held = states[-MARGIN - 2 :], held[-2:]
            positions.append(polisher.refine(states[-2].positions, _through(states), *held[0])[0])
    if len(times) > 1:
        positions.append(states[-1].positions)
    return Anchors(0, times, np.array(positions, np.float32), np.array(residuals), float(times[0]))


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


class _Reader:
    """Photographs by time, and the reference they are compared with."""

    def __init__(self, rig: Rig, frames: FrameSource, times_s: NDArray, settings: TrackSettings) -> None:
        self.rig, self.frames, self.settings = rig, frames, settings
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
