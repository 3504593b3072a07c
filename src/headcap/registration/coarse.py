"""The coarse pass: frame after frame at reduced resolution, by dense flow, equation 6 and the deformation graph.

Each frame starts from the motion so far carried on, is rendered into every view at the moment of that view's photograph, and is
moved by the flow to the photograph: first nearly rigidly, then as softly as the graph allows. A last step of surface flow adds
what the graph cannot follow. The comparison is always with the fixed reference, so errors do not add up over time.

Cameras do not fire together. Nothing is resampled in time: a camera's photograph is compared with the mesh where it is at that
photograph's moment, X(t) + (photograph's time - t) * velocity. The coarse pass takes the velocity from the frames
before and the running estimate, and how it changes from the views' own disagreement (`shutter`); the fine pass interpolates the
coarse trajectory on both sides and corrects it in the same way.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from headcap.meshes.normals import vertex_normals
from headcap.reconstruction.points import PointCloud
from headcap.registration.correspondence import (
    VertexTargets,
    ViewFlow,
    pairs_normal,
    point_pairs,
    residual_spread_px,
    targets_normal,
    texture_strength,
    vertex_targets,
)
from headcap.registration.flow import dense_flow
from headcap.registration.graph import GraphSolver, Pose, build_graph, predict
from headcap.registration.local_contrast import normalise
from headcap.registration.motion import Motion
from headcap.registration.photographs import Photograph
from headcap.registration.photometric import Normal, PhotometricSettings, ViewComparison, inner
from headcap.registration.reference import Reference
from headcap.registration.refine import Refiner
from headcap.registration.render import project, shade, visible_vertices
from headcap.registration.shutter import fit_motion, shifted
from headcap.registration.template import Template
from headcap.registration.track_settings import TrackSettings

CAUTIOUS_BEND, BENDS = 0.25, (-0.5, 1.5)
"""Bend of the motion before the views have told it, and its bounds: see `BackwardMotion`."""


@dataclass(frozen=True)
class CoarseState:
    """Where the coarse pass stands after a frame."""

    time_s: float
    pose: Pose
    displacement: NDArray[np.float64]
    """(n, 3) of the vertices from where the graph puts them."""
    positions: NDArray[np.float64]
    """(n, 3)."""


class CoarseTracker:
    """Carries one template through the frames of a take at reduced resolution."""

    def __init__(self, reference: Reference, settings: TrackSettings) -> None:
        self.reference, self.settings = reference, settings
        template = reference.template
        firm = firmness(reference, settings.graph.inner_lips)
        self.graph = build_graph(template.vertices, template.triangles, settings.graph, fine=lip_vertices(template), shown=firm)
        self.solver = GraphSolver(self.graph, settings.graph)
        self.refiner = Refiner(template.vertices, template.triangles, settings.refine)

    def start(self, time_s: float) -> CoarseState:
        """The reference frame."""
        return CoarseState(time_s, self.graph.rest, np.zeros_like(self.graph.vertices), self.graph.vertices)

    def advance(
        self,
        before: CoarseState,
        earlier: CoarseState | None,
        time_s: float,
        photographs: list[Photograph],
        cloud: PointCloud | None,
        finish: Finish | None = None,
    ) -> tuple[CoarseState, dict[str, float]]:
        """Track one frame from the two before it; also the residuals left.

        `finish` has the last word about the frame's positions, given the motion about it.
        """
        pose = before.pose
        if earlier is not None:
            pose = predict(before.pose, earlier.pose, (time_s - before.time_s) / (before.time_s - earlier.time_s))
        displacement, bend, cloud_pairs = before.displacement, CAUTIOUS_BEND, None
        figures: dict[str, float] = {}
        for _ in range(self.settings.coarse_rounds):
            positions = self.graph.deform(pose) + displacement
            frame = _Frame(time_s, before, earlier, photographs, cloud)
            pose, bend, cloud_pairs, figures = self._round(pose, displacement, bend, frame)
            step_mm = 1e3 * float(np.percentile(np.linalg.norm(self.graph.deform(pose) + displacement - positions, axis=1), 99))
            if step_mm < self.settings.coarse_settled_mm:
                break
        for _ in range(self.settings.coarse_refinements):
            positions = self.graph.deform(pose) + displacement
            motion = BackwardMotion.between(time_s, positions, before, earlier, bend)
            flow = SurfaceFlow(self.reference, positions, motion, photographs, self.settings.coarse_photometric)
            normal = flow.normal(positions)
            if cloud_pairs is not None:
                triangles = self.reference.template.triangles
                normal = normal + pairs_normal(cloud_pairs, positions, triangles, self.settings.correspondence, slide=True)
            displacement = displacement + self.refiner.solve(normal, displacement)
        surface = self.graph.deform(pose)
        if finish is not None:
            positions = surface + displacement
            motion = BackwardMotion.between(time_s, positions, before, earlier, bend)
            displacement = finish(positions, motion) - surface
        return CoarseState(time_s, pose, displacement, surface + displacement), figures

    def _round(self, pose: Pose, displacement: NDArray, bend: float, frame: _Frame):
        settings, triangles = self.settings, self.reference.template.triangles
        positions = self.graph.deform(pose) + displacement
        delays = [photograph.delay_s for photograph in frame.photographs]
        offsets = frame.motion(positions, bend).offsets(delays)
        views = [self._flow(positions + o, p) for p, o in zip(frame.photographs, offsets, strict=True)]
        targets = [self._targets(view, positions + o) for view, o in zip(views, offsets, strict=True)]
        pairs = None
        if frame.cloud is not None:
            pairs = point_pairs(frame.cloud, views, offsets, positions, triangles, settings.correspondence)
        # far from the targets their scatter is motion still to be found, not error: the robust scale shrinks step by step
        spread = residual_spread_px(targets, [positions + offset for offset in offsets])
        for step in range(settings.graph.steps):
            surface = self.graph.deform(pose)
            positions = surface + displacement
            robust_px = max(settings.flow_robust_px, 3 * spread * 0.3**step)
            normal, bend = _sum_targets(targets, positions, frame.motion(positions, bend), delays, robust_px)
            if pairs is not None:
                normal = normal + pairs_normal(pairs, positions, triangles, settings.correspondence)
            pose = self.solver.step(pose, normal, surface, frame.before.pose)
        return pose, bend, pairs, {"flow_residual_px": normal.residual}

    def _flow(self, positions: NDArray, photograph: Photograph) -> ViewFlow:
        settings, reference = self.settings, self.reference
        camera, source = reference.cameras[photograph.camera], reference.sources[photograph.camera]
        projection = project(camera, positions, reference.template.triangles, margin_px=16)
        rendered, known = shade(projection, reference.template.triangles, source)
        seen = photograph.image[projection.window.slices]
        rendered = _complete(rendered, known, projection.raster.hit, seen, settings.flow.window_px)
        flow = dense_flow(rendered, seen, settings.flow)
        contrast = normalise(rendered, known, window_px=settings.flow.window_px, floor=settings.flow.contrast_floor).image
        strength = texture_strength(contrast, settings.correspondence.texture_strength)
        trusted = inner(known, 1) & (flow.mismatch < settings.correspondence.mismatch_limit)
        return ViewFlow(camera, projection, flow, trusted, strength)

    def _targets(self, view: ViewFlow, positions: NDArray) -> VertexTargets:
        triangles = self.reference.template.triangles
        visible = visible_vertices(view.projection, triangles, len(positions))
        return vertex_targets(view, positions, vertex_normals(positions, triangles), visible, self.settings.correspondence)


def _complete(rendered: NDArray, known: NDArray, hit: NDArray, seen: NDArray, window_px: int) -> NDArray:
    """Fill what the rendering does not know.

    Around the surface the photograph itself stands in, so that silhouettes are no false edges. On the surface (between parted
    lips) the known neighbours' mean stands in: there the photograph would vote for no motion.
    """
    size = (window_px, window_px)
    share = cv2.boxFilter(known.astype(np.float32), -1, size, normalize=False, borderType=cv2.BORDER_CONSTANT)
    total = cv2.boxFilter(rendered * known, -1, size, normalize=False, borderType=cv2.BORDER_CONSTANT)
    near = hit & ~known & (share > 0)
    out = np.where(known, rendered, seen)
    out[near] = total[near] / share[near]
    return out


class SurfaceFlow:
    """All views' photographs beside the rendering of a mesh (n, 3), each at its own moment by `motion`."""

    def __init__(
        self,
        reference: Reference,
        positions: NDArray,
        motion: Motion,
        photographs: list[Photograph],
        settings: PhotometricSettings,
    ) -> None:
        triangles = reference.template.triangles
        normals = vertex_normals(positions, triangles)
        delays = [photograph.delay_s for photograph in photographs]
        self.offsets = motion.offsets(delays)
        self._fields = [motion.fields(delay_s) for delay_s in delays]
        self.views = [
            ViewComparison(
                reference.cameras[p.camera], reference.sources[p.camera], positions + moved, normals, triangles, p.image, settings
            )
            for p, moved in zip(photographs, self.offsets, strict=True)
        ]

    def normal(self, positions: NDArray) -> Normal:
        """What all photographs say about the mesh (n, 3) where it is now; the motion within the frame is corrected on the way."""
        parts = [view.normal(positions + offset) for view, offset in zip(self.views, self.offsets, strict=True)]
        weights = np.clip(fit_motion(parts, self._fields), -1.0, 1.0)
        moved = [np.tensordot(weights, field, axes=1) for field in self._fields]
        self.offsets = [offset + move for offset, move in zip(self.offsets, moved, strict=True)]
        return total([shifted(part, move) for part, move in zip(parts, moved, strict=True)])


Finish = Callable[[NDArray, Motion], NDArray]
"""Positions (n, 3) and the motion about them to better positions (n, 3)."""


@dataclass(frozen=True)
class BackwardMotion:
    """Motion about a frame from the frames before it."""

    velocity: NDArray[np.float64]
    """(n, 3) m / s over the last interval."""
    change: NDArray[np.float64]
    """(n, 3) m / s: the last interval's velocity minus the one's before."""
    bend: float
    """How much of the change to add at the frame: 0.5 on a parabola, less where motion stops, told by the views themselves."""

    @classmethod
    def between(
        cls, time_s: float, positions: NDArray, before: CoarseState, earlier: CoarseState | None, bend: float
    ) -> BackwardMotion:
        """From up to three frames."""
        last = (positions - before.positions) / (time_s - before.time_s)
        if earlier is None:
            return cls(last, np.zeros_like(last), bend)
        previous = (before.positions - earlier.positions) / (before.time_s - earlier.time_s)
        return cls(last, last - previous, bend)

    def offsets(self, delays_s: list[float]) -> list[NDArray[np.float64]]:
        """Motion (n, 3) from the frame to each of the moments `delays_s` later."""
        return [delay_s * (self.velocity + self.bend * self.change) for delay_s in delays_s]

    def fields(self, delay_s: float) -> NDArray[np.float64]:
        """(1, n, 3) what one unit more of bend moves at that moment."""
        return delay_s * self.change[None]


@dataclass(frozen=True)
class _Frame:
    """What one frame is tracked from."""

    time_s: float
    before: CoarseState
    earlier: CoarseState | None
    photographs: list[Photograph]
    cloud: PointCloud | None

    def motion(self, positions: NDArray, bend: float) -> BackwardMotion:
        """Motion about the frame with the mesh (n, 3) there."""
        return BackwardMotion.between(self.time_s, positions, self.before, self.earlier, bend)


def _sum_targets(
    targets: list[VertexTargets], positions: NDArray, motion: BackwardMotion, delays_s: list[float], robust_px: float
):
    """Normal equations of all views' targets, and the bend of the motion that they agree on."""
    offsets, fields = motion.offsets(delays_s), [motion.fields(delay_s) for delay_s in delays_s]
    parts = [targets_normal(target, positions + o, robust_px) for target, o in zip(targets, offsets, strict=True)]
    bend = float(np.clip(motion.bend + fit_motion(parts, fields)[0], *BENDS))
    moved = [(bend - motion.bend) * field[0] for field in fields]
    return total([shifted(part, move) for part, move in zip(parts, moved, strict=True)]), bend


def total(parts: list[Normal]) -> Normal:
    """Sum of the views' normal equations; its residual is their median."""
    whole = Normal.zero(len(parts[0].right))
    for part in parts:
        whole = whole + part
    return Normal(whole.blocks, whole.right, float(np.median([part.residual for part in parts])))


def lip_vertices(template: Template) -> NDArray[np.bool_] | None:
    """(n,) the lips, outside and inside; None where the template names none."""
    masks = [mask for name, mask in template.regions.items() if name.startswith("lips")]
    return np.any(masks, axis=0) if masks else None


def firmness(reference: Reference, inner_lips: float) -> NDArray[np.float64]:
    """(n,) 1 where the reference frame shows the skin, 0 where it is hidden, between them on the lips' hidden inner sides.

    These are a part of the lips and go with them, but no photograph holds them: quite free they drift apart behind closed lips
    when the head is shaken, as firm as skin they keep the lips from rolling when the mouth opens.
    """
    masks = [mask for name, mask in reference.template.regions.items() if name.startswith("lips_inner")]
    inside = np.any(masks, axis=0) if masks else np.zeros(len(reference.shown), np.bool_)
    return np.where(reference.shown, 1.0, inner_lips * inside)
