"""From frame to frame: start, follow, notice a loss and begin again; a frame without an answer is marked and never made up."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

import cv2
import numpy as np
from numpy.typing import NDArray

from headcap.cameras import Camera
from headcap.errors import InputError
from headcap.heads import HeadModel
from headcap.lips.monocular import detections
from headcap.lips.monocular.alignment import flow_features, open_eyed_colour
from headcap.lips.monocular.finder import RIVAL_SHARE, find_faces, followed, generic_colour, mistaken
from headcap.lips.monocular.harmonics import COEFFICIENTS, harmonics
from headcap.lips.monocular.person import MonocularPerson
from headcap.lips.monocular.photometric import Level, observed
from headcap.lips.monocular.pictures import cameras_of_levels, finest_share, levels_of
from headcap.lips.monocular.problem import Appearance, Features, FrameProblem, Look, Prior
from headcap.lips.monocular.settings import MonocularSettings
from headcap.lips.monocular.solver import Fit, descend, descend_sparse, paint, relight
from headcap.lips.monocular.surface import JAW, RIGID, Estimate, FaceSurface, Slopes

_START_ROUNDS, _SPARSE_STEPS, _ALIGN_ROUNDS = 3, 8, 4
_NOISE_GAIN = 0.1
"""How fast the usual noise follows a frame's."""
_FLOW_WINDOW_PX, _FLOW_LEVELS, _RETURN_PX = 13, 3, 0.7
_RETURN_SCALES = (1.0, 0.9, 1.11, 0.8, 1.25)


class FrameState(StrEnum):
    """What a frame's answer is worth."""

    STARTED = "started"
    TRACKED = "tracked"
    RESTARTED = "restarted"
    """Found again after a loss."""
    LOST = "lost"
    """No answer."""


@dataclass(frozen=True, eq=False)
class FrameResult:
    """One frame."""

    state: FrameState
    estimate: Estimate | None
    """None where the face is lost."""
    light: NDArray[np.float64] | None
    """(3, 9)."""
    residual: float
    """Root mean square photometric residual per channel of what agrees, linear intensity; NaN where lost."""
    inliers: float
    """Share of the skin in view that looks as rendered."""
    visible: float
    """Skin in view over that of the first frame."""
    correlation: float
    """Zero-mean normalised cross-correlation of rendering and picture over the skin in view."""
    others: int = 0
    """Smaller faces in a picture in which the face was looked for; the largest one is followed."""


@dataclass(frozen=True, eq=False)
class _Memory:
    """What the next frame starts from."""

    estimate: Estimate
    appearance: Appearance
    look: Look
    grey: NDArray[np.uint8]
    slopes: Slopes


class MonocularTracker:
    """Follows one face in one camera's pictures (height, width, 3) uint8, sRGB-encoded, channels in any but one order."""

    def __init__(
        self,
        model: HeadModel,
        camera: Camera,
        settings: MonocularSettings | None = None,
        *,
        focal_known: bool = True,
        person: MonocularPerson | None = None,
    ) -> None:
        """`camera` may stand anywhere: estimates are in its own axes. An unknown focal length is estimated at the first frame.

        A `person` who is known already is placed there, and not estimated.
        """
        self.settings = settings or MonocularSettings()
        chosen = self.settings
        limits = {"harmonics": chosen.harmonics, "harmonic_m": 1e-3 * chosen.harmonic_mm}
        self.surface = FaceSurface(model, chosen.expressions, chosen.shapes, **limits, person=person)
        self.camera, self.focal_known = replace(camera, camera_from_world=np.eye(4)), focal_known
        jaw_rad = float(np.radians(self.settings.jaw_deg[0]))
        self._steadiness = self.surface.steadiness(jaw_rad, 1e-3 * self.settings.steady_mm)
        self._cameras: list[Camera] = []
        self._memory: _Memory | None = None
        self._known_pixels, self._noise, self._lost = 0.0, np.inf, False
        self._first: Estimate | None = None
        self._others = 0

    # -- first frame ----------------------------------------------------------------------------------------------------------

    def start(self, picture: NDArray[np.uint8], points: NDArray | None = None) -> FrameResult:
        """Identity, albedo, light and pose from a frame of an about neutral face.

        `points` (68, 468 or 478, 2) are what a detector found; without any the face is looked for, seen from the front, and of
        several the largest is followed. Raises `InputError` for a picture of another size, points that are no face, a picture
        without a face, and one with two that are about as large.
        """
        self._check(picture)
        surface, self._others = self.surface, 0
        if points is None:
            problem, estimate, appearance = self._looked_for(picture)
        else:
            problem, estimate, appearance = self._identified(picture, points)
        appearance = self._painted(problem, estimate, appearance)
        self._first = estimate
        result = self._remember(FrameState.STARTED, problem, estimate, appearance, self._grey(picture), surface.slopes(estimate))
        if result is None:
            raise InputError(
                "a face that does not look like one", expected="a face seen from the front", remedy="Check the points."
            )
        return replace(result, others=self._others)

    def take_up(self, picture: NDArray[np.uint8], estimate: Estimate) -> FrameResult:
        """A frame of which all but the light is known; the first one that is taken up tells the albedo as well.

        `LOST` where the picture does not look like the face there. Raises `InputError` for a picture of another size.
        """
        self._check(picture)
        if self._memory is None:
            state, problem = FrameState.STARTED, self._first_problem(picture, estimate, [])
            appearance = self._relit(problem, estimate, self._plain_appearance(len(problem.levels)), 0, _START_ROUNDS)
            appearance, self._first = self._painted(problem, estimate, appearance), estimate
        else:
            state, prior = FrameState.TRACKED, Prior.of(self.surface, self.settings)
            levels = levels_of(picture, self._cameras)
            problem = FrameProblem(self.surface, levels, prior, self.settings, [], self._most_noise)
            appearance = self._relit(problem, estimate, self._memory.appearance, 0, _START_ROUNDS)
        slopes = self.surface.slopes(estimate)
        return self._remember(state, problem, estimate, appearance, self._grey(picture), slopes) or _lost()

    def _identified(self, picture: NDArray[np.uint8], points: NDArray) -> tuple[FrameProblem, Estimate, Appearance]:
        """The face at detected points, and the person by its shading."""
        surface, settings, free = self.surface, self.settings, self._free_at_start()
        features = [detections.matched(surface, points, self.camera, settings.landmark_noise_share)]
        sparse = FrameProblem(surface, (), Prior.of(surface, settings), settings, features)
        estimate = surface.at_rest(detections.place(surface, features[0]))
        estimate = descend_sparse(sparse, estimate, free, _SPARSE_STEPS)
        problem = self._first_problem(picture, estimate, features)
        appearance = self._relit(problem, estimate, self._plain_appearance(len(problem.levels)), 0, _START_ROUNDS)
        # identity at the finest resolution alone: coarse pixels average curved shading, which looks like a flatter face
        for _ in range(_START_ROUNDS):
            slopes = surface.slopes(estimate, shape=True, focal=bool(free[-1]))
            fit = descend(problem, estimate, appearance, 0, free, slopes)
            estimate, appearance = fit.estimate, fit.appearance
        return problem, estimate, appearance

    def _looked_for(self, picture: NDArray[np.uint8]) -> tuple[FrameProblem, Estimate, Appearance]:
        """A face of generic albedo, laid on the picture's; raises `InputError` where there seems to be none."""
        surface, least = self.surface, self.settings.least_face_score
        faces = find_faces(surface, self.camera, picture, RIVAL_SHARE * least)
        if not faces or faces[0].score < least:
            score = f", the best place is {faces[0].score:.2f} like one" if faces else ""
            raise InputError(
                f"no face in the picture{score}",
                expected=f"a face seen from the front, {least:.2f} like one",
                remedy="Give a detector's points for this frame, or begin at a frame that shows the face from the front.",
            )
        found, others = followed(faces)
        self._others = len(others)
        problem = self._first_problem(picture, surface.at_rest(found.camera_from_head), [])
        fits = [self._laid(problem, surface.at_rest(place)) for place in mistaken(found)]
        best = max(fits, key=lambda fit: _correlation(fit.look, surface.triangles, fit.appearance.trust))
        return problem, *self._aligned(problem, best.estimate, best.appearance)

    def _aligned(self, problem: FrameProblem, estimate: Estimate, appearance: Appearance) -> tuple[Estimate, Appearance]:
        """A laid face drawn to the picture's lips, nostrils, lids and brows, and shaded with these held."""
        surface, free = self.surface, self._free_at_start()
        free[-1] = False
        appearance = replace(appearance, albedo=(open_eyed_colour(surface),) * len(problem.levels))
        features = None
        for _ in range(_ALIGN_ROUNDS):
            appearance = self._relit(problem, estimate, appearance, 0, 2)
            features = flow_features(surface, problem.levels[0], estimate, appearance, 0)
            if features is None:
                return estimate, appearance
            sparse = FrameProblem(surface, (), problem.prior, self.settings, [features])
            estimate = descend_sparse(sparse, estimate, free, _SPARSE_STEPS)
        held = problem.helped_by(features)
        for level in reversed(range(len(problem.levels))):
            appearance = self._relit(held, estimate, appearance, level, 1)
            fit = descend(held, estimate, appearance, level, free, surface.slopes(estimate, shape=True))
            estimate, appearance = fit.estimate, fit.appearance
        return estimate, appearance

    def _first_problem(self, picture: NDArray[np.uint8], estimate: Estimate, features: list[Features]) -> FrameProblem:
        """The first frame at the resolutions that suit the face's size there."""
        surface, settings = self.surface, self.settings
        share = finest_share(surface, self.camera, estimate, settings.finest_edge_px)
        self._cameras = cameras_of_levels(self.camera, share, settings.levels)
        levels, prior = levels_of(picture, self._cameras), Prior.of(surface, settings)
        return FrameProblem(surface, levels, prior, settings, features, correlated_mm=settings.correlated_start_mm)

    def _laid(self, problem: FrameProblem, estimate: Estimate) -> Fit:
        """A face of generic albedo, moved and shaped until it lies on the picture's, coarse to fine."""
        colour, n_levels = generic_colour(self.surface), len(problem.levels)
        light = np.zeros((3, COEFFICIENTS))
        appearance = Appearance(light, (colour,) * n_levels, np.ones(len(colour)))
        free = self._free_at_start()
        free[-1] = False
        for level in reversed(range(n_levels)):
            appearance = self._relit(problem, estimate, appearance, level, _START_ROUNDS)
            fit = descend(problem, estimate, appearance, level, free, self.surface.slopes(estimate, shape=True))
            estimate, appearance = fit.estimate, fit.appearance
        return fit

    def _free_at_start(self) -> NDArray[np.bool_]:
        """What one neutral frame shows is identity: with expressions free as well, their waves would paint the albedo."""
        free = np.ones(self.surface.unknowns, bool)
        free[JAW] = free[self.surface.expression_columns] = False
        free[-1] = not self.focal_known
        return free

    def _plain_appearance(self, levels: int) -> Appearance:
        """Skin of one colour; lips and brows are not believed to have it."""
        surface = self.surface
        trust = np.where(surface.blind, 0.0, 1.0)
        for name, mask in surface.model.regions.items():
            if name.startswith("lip"):
                trust[mask[surface.vertices]] = 0.0
        light = np.zeros((3, COEFFICIENTS))
        ones = np.ones((len(surface.vertices), 3))
        return Appearance(light, (ones,) * levels, trust)

    def _relit(self, problem: FrameProblem, estimate: Estimate, appearance: Appearance, level: int, rounds: int) -> Appearance:
        for _ in range(rounds):
            if not appearance.light.any():
                appearance = replace(appearance, light=self._first_light(problem, estimate, appearance, level))
            appearance = relight(problem.look(estimate, appearance, level), appearance, level, self.settings)
        return appearance

    def _first_light(self, problem: FrameProblem, estimate: Estimate, appearance: Appearance, level: int) -> NDArray:
        """Light from all around that gives the median colour of the skin in view."""
        look = problem.look(estimate, appearance, level, 1e3)
        seen, weight = observed(look.photo, look.colours)
        light = np.zeros((3, COEFFICIENTS))
        if not (weight > 0).any():
            raise InputError("no skin in the picture", expected="a face inside it", remedy="Check the detected points.")
        light[:, 0] = np.median(seen[weight > 0], axis=0) / harmonics(np.array([0.0, 0.0, 1.0]))[0]
        return light

    def _painted(self, problem: FrameProblem, estimate: Estimate, appearance: Appearance) -> Appearance:
        """The skin's own albedo where this frame shows it."""
        everything = replace(appearance, trust=np.where(self.surface.blind, 0.0, 1.0))
        # a wide robust scale: brows and lips are what they are, and no outliers any more
        looks = [problem.look(estimate, everything, level, 1e3) for level in range(len(problem.levels))]
        return paint(looks, everything, np.ones((len(self.surface.vertices), 3)), self.settings)

    # -- further frames -------------------------------------------------------------------------------------------------------

    def follow(self, picture: NDArray[np.uint8], points: NDArray | None = None, steps: float = 1.0) -> FrameResult:
        """The next frame, from the one before; `points` (68, 468 or 478, 2), where a detector found any, help.

        `steps` is how long ago that was, in the video's usual intervals: over a gap a face changes more.

        Raises `InputError` where nothing has been started, or for a picture of another size.
        """
        if self._memory is None:
            raise InputError("no first frame", expected="a started tracker", remedy="Start it with a frame and its points.")
        self._check(picture)
        levels = levels_of(picture, self._cameras)
        grey = self._grey(picture)
        given = self._given(points)
        if not self._lost:
            result = self._from_before(levels, grey, given, steps)
            if result is not None:
                return result
        self._lost = True
        return self._found_again(levels, grey, given) or _lost()

    def _grey(self, picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """At the finest resolution used."""
        return cv2.resize(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), self._cameras[0].size, interpolation=cv2.INTER_AREA)

    def _given(self, points: NDArray | None) -> list[Features]:
        if points is None:
            return []
        try:
            return [detections.matched(self.surface, points, self.camera, self.settings.landmark_noise_share)]
        except InputError:
            # a detector may see half a face: what it saw does not help, and does no harm
            return []

    def _from_before(self, levels: list[Level], grey: NDArray, given: list[Features], steps: float) -> FrameResult | None:
        """The frame from the one before, None where it is lost."""
        before = self._memory
        prior = Prior.of(self.surface, self.settings).near(self.surface, before.estimate, self.settings, steps)
        free, slopes = self._free(), before.slopes
        sparse = given + self._flow(before, grey)
        estimate = before.estimate
        if sparse:
            problem = FrameProblem(self.surface, (), prior, self.settings, sparse)
            estimate = descend_sparse(problem, estimate, free, 4, slopes)
        problem = FrameProblem(self.surface, levels, prior, self.settings, given, self._most_noise)
        return self._fitted(FrameState.TRACKED, problem, estimate, before.appearance, grey)

    def _fitted(
        self, state: FrameState, problem: FrameProblem, estimate: Estimate, appearance: Appearance, grey: NDArray
    ) -> FrameResult | None:
        """Coarse to fine from a start; None where the picture does not agree with what comes out.

        On coarse resolutions the head's motion comes first, by the skin that expressions move least, then jaw and expression on
        a head held still: together they mistake a jaw that opens for a head that nods, and stay there. The finest has all free.
        """
        slopes, free, last = self.surface.slopes(estimate), self._free(), len(problem.levels) - 1
        rigid, steady = np.arange(len(free)) < RIGID.stop, appearance.trust * self._steadiness
        for level in range(last, 0, -1):
            fit = descend(problem, estimate, replace(appearance, trust=steady), level, free & rigid, slopes)
            estimate, appearance = fit.estimate, replace(appearance, light=fit.appearance.light)
            fit = descend(problem, estimate, appearance, level, free & ~rigid, slopes)
            estimate, appearance = fit.estimate, fit.appearance
        fit = descend(problem, estimate, appearance, 0, free, slopes)
        estimate, appearance = fit.estimate, fit.appearance
        return self._remember(state, problem, estimate, appearance, grey, slopes)

    def _free(self) -> NDArray[np.bool_]:
        """Identity and lens are the first frame's."""
        free = np.ones(self.surface.unknowns, bool)
        free[self.surface.shape_columns] = False
        free[-1] = False
        return free

    def _flow(self, before: _Memory, grey: NDArray) -> list[Features]:
        """Pieces of skin of the frame before, found in this one by optical flow there and back (Lucas and Kanade, pyramids)."""
        trusted = before.appearance.trust * before.look.photo.sums[:, 0] > 0.2
        seen = np.flatnonzero(trusted)
        if self.settings.flow_points == 0 or len(seen) < detections.LEAST_LANDMARKS:
            return []
        seen = seen[:: max(1, len(seen) // self.settings.flow_points)]
        start = before.look.view.pixels[seen].astype(np.float32).reshape(-1, 1, 2)
        given = {"winSize": (_FLOW_WINDOW_PX, _FLOW_WINDOW_PX), "maxLevel": _FLOW_LEVELS}
        there, found, _ = cv2.calcOpticalFlowPyrLK(before.grey, grey, start, None, **given)
        back, found_back, _ = cv2.calcOpticalFlowPyrLK(grey, before.grey, there, None, **given)
        away = np.linalg.norm((back - start).reshape(-1, 2), axis=1)
        good = (found.ravel() == 1) & (found_back.ravel() == 1) & (away < _RETURN_PX)
        if good.sum() < detections.LEAST_LANDMARKS:
            return []
        pixels = there.reshape(-1, 2)[good].astype(float)
        return [Features(seen[good], pixels, self.settings.flow_noise_px, self._cameras[0])]

    # -- loss -----------------------------------------------------------------------------------------------------------------

    def _found_again(self, levels: list[Level], grey: NDArray, given: list[Features]) -> FrameResult | None:
        """The face anywhere in the picture, from detected points or by its own look; None where it is not found."""
        for estimate in self._places(levels, given):
            prior = Prior.of(self.surface, self.settings)
            problem = FrameProblem(self.surface, levels, prior, self.settings, given, self._most_noise)
            result = self._fitted(FrameState.RESTARTED, problem, estimate, self._memory.appearance, grey)
            if result is not None:
                self._lost = False
                return result
        return None

    def _places(self, levels: list[Level], given: list[Features]):
        """Where to look: at the detected points, else where the coarsest picture is most like the face as last seen."""
        rest = replace(self._first, expression=np.zeros(self.surface.expressions), jaw=np.zeros(3))
        for features in given:
            problem = FrameProblem(self.surface, (), Prior.of(self.surface, self.settings), self.settings, [features])
            start = replace(rest, camera_from_head=detections.place(self.surface, features))
            yield descend_sparse(problem, start, self._free(), _SPARSE_STEPS)
        if not given:
            yield from self._like_before(levels[-1], rest)

    def _like_before(self, level: Level, rest: Estimate):
        """Best places of the first frame's face, rendered at several distances, by normalised cross-correlation."""
        problem = FrameProblem(self.surface, [level], Prior.of(self.surface, self.settings), self.settings)
        appearance = replace(self._memory.appearance, albedo=self._memory.appearance.albedo[-1:])
        found = []
        for scale in _RETURN_SCALES:
            nearer = rest.camera_from_head.copy()
            nearer[2, 3] /= scale
            estimate = replace(rest, camera_from_head=nearer)
            look = problem.look(estimate, appearance, 0, 1.0)
            place = _best_place(level, look, self.surface.triangles)
            if place is not None:
                score, way = place
                nearer = nearer.copy()
                nearer[:2, 3] += way * nearer[2, 3] / level.camera.matrix[[0, 1], [0, 1]] / np.exp(rest.log_focal)
                found.append((score, replace(rest, camera_from_head=nearer)))
        yield from (estimate for _, estimate in sorted(found, key=lambda pair: -pair[0])[:2])

    # -- bookkeeping ----------------------------------------------------------------------------------------------------------

    @property
    def _most_noise(self) -> float:
        """Residuals are never taken for noise beyond this: what looks nothing like the face is no noisy face."""
        look = self._memory.look
        bright = float(np.abs(look.colours[look.photo.sums[:, 0] > 0]).mean())
        return min(self.settings.most_noise_share * bright, self.settings.noise_growth * self._noise)

    def _remember(self, state, problem, estimate, appearance, grey, slopes) -> FrameResult | None:
        """The result, if it is one, kept for the next frame."""
        look = problem.look(estimate, appearance, 0)
        photo, noise = look.photo, look.photo.scale / self.settings.robust_sigmas
        if state is FrameState.STARTED:
            self._known_pixels = photo.pixels
        inliers, visible = photo.inliers / max(photo.pixels, 1e-9), photo.pixels / max(self._known_pixels, 1e-9)
        alike = _correlation(look, self.surface.triangles, appearance.trust)
        settings = self.settings
        good = inliers >= settings.least_inliers and visible >= settings.least_visible and alike >= settings.least_correlation
        if state is FrameState.RESTARTED:
            good &= noise <= settings.restart_growth * self._noise
        if not good:
            return None
        if state is FrameState.TRACKED:
            self._noise = noise if np.isinf(self._noise) else self._noise + _NOISE_GAIN * (noise - self._noise)
        self._memory = _Memory(estimate, appearance, look, grey, slopes)
        residual = float(np.sqrt(photo.squares / max(photo.inliers, 1e-9) / 3.0))
        return FrameResult(state, estimate, appearance.light, residual, inliers, visible, alike)

    def _check(self, picture: NDArray) -> None:
        if picture.dtype != np.uint8 or picture.shape != (self.camera.height, self.camera.width, 3):
            raise InputError(
                f"a picture of {picture.shape} {picture.dtype}",
                expected=f"({self.camera.height}, {self.camera.width}, 3) uint8, as the camera {self.camera.name}",
                remedy="Give the camera of this video.",
            )


def _lost() -> FrameResult:
    return FrameResult(FrameState.LOST, None, None, np.nan, 0.0, 0.0, np.nan)


def _rendered(look: Look, triangles: NDArray, trust: NDArray | None = None) -> tuple[NDArray, NDArray]:
    """Rendered colours (k, 3) and the pixels (height, width) they belong to, of trusted skin."""
    here = look.view.usable.copy()
    corners = triangles[look.view.raster.triangle[here]]
    if trust is not None:
        known = trust[corners].min(axis=1) > 0
        here[here] = known
        corners = corners[known]
    return np.einsum("kj,kjc->kc", look.view.shares[here], look.colours[corners]), here


def _correlation(look: Look, triangles: NDArray, trust: NDArray) -> float:
    """Zero-mean normalised cross-correlation of rendering and picture, robustly weighted; -1 where no skin is in view."""
    rendered, here = _rendered(look, triangles, trust)
    if len(rendered) < 10:
        return -1.0
    left = ((look.level.picture[here] - rendered) ** 2).sum(axis=1)
    weight = 1.0 / (1.0 + left / look.photo.scale**2) ** 2
    a, b = rendered.mean(axis=1), look.level.picture[here].mean(axis=1)
    a, b = a - np.average(a, weights=weight), b - np.average(b, weights=weight)
    return float((weight * a) @ b / max(np.sqrt(((weight * a) @ a) * ((weight * b) @ b)), 1e-12))


def _best_place(level: Level, look: Look, triangles: NDArray) -> tuple[float, NDArray] | None:
    """The highest correlation of the rendered face with the picture, and the way (2,) there from where it was rendered, px."""
    rendered, here = _rendered(look, triangles)
    rows, columns = np.nonzero(here)
    if len(rows) < 30:
        return None
    (top, left), (bottom, right) = (rows.min(), columns.min()), (rows.max() + 1, columns.max() + 1)
    template = np.zeros((*here.shape, 3), np.float32)
    template[here] = rendered
    mask = np.repeat(here[..., None], 3, axis=2).astype(np.float32)
    box = (slice(top, bottom), slice(left, right))
    scores = cv2.matchTemplate(level.picture, template[box], cv2.TM_CCOEFF_NORMED, mask=mask[box])
    scores = np.where(np.isfinite(scores), scores, -1.0)
    y, x = np.unravel_index(int(scores.argmax()), scores.shape)
    return float(scores[y, x]), np.array([x - left, y - top], float)
