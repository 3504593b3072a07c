"""Fitting a mesh sequence in the order that the caller fixes: identity, pose, expression, larynx, speech (section 5.2).

The paper alternates larynx and blendshape coefficients "for a few times". Here a stage that comes before its partner (pose before
expression, larynx before speech) is solved for with the partner's best answer to it, so that one pass reaches what alternation
creeps to; stages may be given twice all the same, and are then solved with all others as they stand.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from headcap.errors import InputError
from headcap.heads import JOINTS, HeadCoefficients, HeadModel, RestOffset
from headcap.neck.animation.curves import CoefficientCurves
from headcap.neck.fitting.chosen_vertices import model_of_vertices
from headcap.neck.fitting.compensation import BLOCK, ExpressionSolver, FitSettings, check_topology, without_expressions
from headcap.neck.fitting.identity import IdentitySettings, fit_identity_to_sequence
from headcap.neck.fitting.person import empty_larynx
from headcap.neck.fitting.pose import PoseEstimator, Poses
from headcap.neck.fitting.speech import SpeechFitter, checked_mask
from headcap.neck.fitting.temporal import TemporalPrior, smoothed, smoothed_placements
from headcap.neck.frame_blocks import in_blocks
from headcap.neck.larynx.coefficients import SlideSettings
from headcap.neck.model import NeckModel, NeckPerson

ORDER = ("pose", "expression", "larynx", "speech")
COEFFICIENTS = {
    "identity": ("beta",),
    "pose": ("theta", "placement"),
    "expression": ("psi",),
    "larynx": ("tau", "alpha"),
    "speech": ("phi",),
}
"""Each stage's coefficients, as they are named where they are held."""


class SequenceFitSettings(BaseModel):
    """Fitting a sequence."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    fit: FitSettings = Field(default_factory=FitSettings)
    slide: SlideSettings = Field(default_factory=SlideSettings)
    identity: IdentitySettings = Field(default_factory=IdentitySettings)
    temporal: TemporalPrior | None = Field(None, description="None: every frame stands for itself")


@dataclass(frozen=True, eq=False)
class SequenceFit:
    """Coefficients of f frames; NaN where a frame could not be fitted."""

    person: NeckPerson
    beta: NDArray[np.float64] | None
    """(s,) where the identity was solved for or held as coefficients."""
    time_s: NDArray[np.float64]
    theta: NDArray[np.float64]
    """(f, 2, 3) rotation vectors of neck and jaw, radians."""
    placement: NDArray[np.float64]
    """world_from_head (f, 4, 4)."""
    psi: NDArray[np.float64]
    """(f, e)."""
    tau_m: NDArray[np.float64]
    """(f,)."""
    alpha: NDArray[np.float64]
    """(f,)."""
    phi: NDArray[np.float64]
    """(f, p)."""
    error_mm: NDArray[np.float64]
    """(f,) mean 3D vertex error over the neck region, of what was seen of it (section 7.1)."""
    measured: NDArray[np.bool_]
    """(f,) frames whose mesh was finite; under a temporal prior the others are filled in."""

    @property
    def skipped(self) -> int:
        """Frames whose mesh was not finite."""
        return int((~self.measured).sum())

    def curves(self, model_version: str) -> CoefficientCurves:
        """As `headcap animate` reads them; gaps are filled linearly."""
        channels = {"tau": self.tau_m, "alpha": self.alpha, "phi": self.phi, "psi": self.psi}
        channels |= {name: self.theta[:, k] for k, name in enumerate(JOINTS)}
        known = np.isfinite(self.tau_m) & np.isfinite(self.placement).all(axis=(1, 2))
        return CoefficientCurves.filled(self.time_s, channels, self.placement, known, model_version, self.person.name)


def fit_sequence(
    model: NeckModel,
    person: NeckPerson | None,
    meshes: NDArray,
    order: Sequence[str] = ORDER,
    held: Mapping[str, NDArray] | None = None,
    settings: SequenceFitSettings | None = None,
    *,
    time_s: NDArray | None = None,
    seen: NDArray[np.bool_] | None = None,
) -> SequenceFit:
    """Coefficients of meshes (f, n, 3) in metres, in memory or read when indexed by slices, by stages in the order given.

    Each stage is a least-squares minimum over its own coefficients, the others as they stand: where a stage before, or `held`
    (names of `COEFFICIENTS`, one row per frame; beta (s,)), has put them, otherwise at rest. Exceptions: pose before a first
    expression stage, and larynx before a first speech stage, are solved for together with psi and phi. A stage that is left out
    and not held stays at rest. `identity` may only come first, where `person` is None: the shape over the whole sequence, and
    from it the person by eq. 8 to 10. `seen` (n,) masks what cameras saw. With a temporal prior, what was solved for is smoothed
    over the sequence and frames that are not finite (NaN otherwise) are filled; `time_s` (f,) defaults to 60 frames per second.
    Memory grows by the coefficients alone. Raises `InputError` for unknown or conflicting names, curves of another
    length, another topology, no finite frame, or no person.
    """
    settings, held = settings or SequenceFitSettings(), {k: np.asarray(v, float) for k, v in (held or {}).items()}
    check_topology(model.head, meshes)
    _check(model.head, person, len(meshes), order, held)
    seen = checked_mask(seen, len(model.head.vertices))
    beta = held.get("beta")
    if "identity" in order:
        beta = fit_identity_to_sequence(model.head, meshes, settings.identity, seen).beta
    if person is None:
        neutral = np.asarray(model.head.identity(beta), float)
        person = NeckPerson.of("fitted", neutral, model.head.triangles, empty_larynx(model))
    time_s = np.arange(len(meshes)) / 60.0 if time_s is None else np.asarray(time_s, float)
    stages = tuple(stage for stage in order if stage != "identity")
    fitter = _BlockFitter(model, person, stages, settings, seen)
    found = _fitted(fitter, meshes, held)
    if settings.temporal is not None:
        found = _smoothed(found, stages, time_s, settings.temporal)
    error = _errors(model, person, meshes, found, seen)
    return SequenceFit(person, beta, time_s, **found.curves, error_mm=error, measured=found.measured)


@dataclass(frozen=True, eq=False)
class _Found:
    curves: dict[str, NDArray]
    """theta, placement, psi, tau_m, alpha, phi over all frames."""
    measured: NDArray[np.bool_]


class _Block:
    """Some frames in the course of fitting: coefficients that are None have no value yet and count as at rest."""

    def __init__(self, meshes: NDArray, held: Mapping[str, NDArray]) -> None:
        self.meshes = meshes
        self.theta, self.placement = held.get("theta"), held.get("placement")
        self.psi, self.phi = held.get("psi"), held.get("phi")
        self.tau, self.alpha = held.get("tau"), held.get("alpha")
        self.unposed: NDArray | None = None
        """(f, n, 3) meshes at rest without pose correctives, for the pose as it stands."""


class _BlockFitter:
    """All stages on blocks of frames, in order of time."""

    def __init__(
        self, model: NeckModel, person: NeckPerson, stages: tuple[str, ...], settings: SequenceFitSettings, seen
    ) -> None:
        self.head = model.head.personal(person.base)
        self.person, self.stages = person, stages
        self._joints = self.head.joints()
        self._neutral = np.array(person.base)
        self._neutral[person.larynx.vertices] += person.larynx.offset(0.0, 1.0).values
        self._expression = self.head.expression_basis.reshape(len(self.head.expression_basis), self.head.vertices.size)
        self._solver = ExpressionSolver(self.head, settings.fit, seen) if "expression" in stages else None
        self._speech = SpeechFitter(self.head, person, settings.slide, seen)
        expressions = "expression" in stages and "pose" in stages and stages.index("pose") < stages.index("expression")
        self._joint = PoseEstimator(self.head, settings.fit.pose, seen) if expressions else None
        self._alone = PoseEstimator(without_expressions(self.head), settings.fit.pose, seen) if "pose" in stages else None
        self._warm: dict[int, tuple[Poses, NDArray]] = {}

    def fit(self, block: _Block) -> None:
        """Every stage in turn."""
        for k, stage in enumerate(self.stages):
            getattr(self, f"_{stage}_stage")(block, k)

    def _pose_stage(self, block: _Block, k: int) -> None:
        together = block.psi is None and "expression" in self.stages[k:]
        estimator = self._joint if together else self._alone
        told = estimator.vertices
        shown = None
        for weights, basis in ((block.psi, self.head.expression_basis), (block.phi, self.head.speech_basis)):
            if weights is not None and weights.shape[1]:
                part = np.tensordot(weights, np.asarray(basis[:, told], float), axes=1)
                shown = part if shown is None else shown + part
        poses, psi, _ = estimator.estimate(block.meshes[:, told], self._warm.get(k), shown)
        self._warm[k] = (poses, psi)
        block.theta, block.placement, block.unposed = poses.theta, poses.placement, None

    def _expression_stage(self, block: _Block, k: int) -> None:
        away = self._at_rest(block) - self._neutral.astype(self.head.vertices.dtype)
        if block.phi is not None and block.phi.shape[1]:
            away -= _weighted(block.phi, self.head.speech_basis)
        if block.tau is not None:
            larynx = self.person.larynx
            moved = larynx.offset(block.tau, block.alpha).values - larynx.offset(0.0, 1.0).values
            away[:, larynx.vertices] -= moved.astype(away.dtype)
        block.psi = self._solver(away) if len(self._expression) else np.zeros((len(away), 0))

    def _larynx_stage(self, block: _Block, k: int) -> None:
        rests = self._without_expression(block)
        if block.phi is None and "speech" in self.stages[k:]:
            speech = self._speech.fit(rests)
            block.tau, block.alpha = speech.tau_m, speech.alpha
        else:
            phi = np.zeros((len(rests), len(self.head.speech_basis))) if block.phi is None else block.phi
            block.tau, block.alpha = self._speech.fit_larynx(rests, phi)

    def _speech_stage(self, block: _Block, k: int) -> None:
        rests, still = self._without_expression(block), block.tau is None
        tau = np.zeros(len(rests)) if still else block.tau
        block.phi = self._speech.fit_weights(rests, tau, np.ones(len(rests)) if still else block.alpha)

    def _at_rest(self, block: _Block) -> NDArray:
        """(f, n, 3) meshes with pose, placement and pose correctives taken off, for the stage to change."""
        if block.unposed is None:
            block.unposed = self.head.unskinned(block.meshes, self._joints, block.theta, block.placement)
            if block.theta is not None and self.head.pose_basis.any():
                block.unposed -= self.head.rest(HeadCoefficients(pose=block.theta)) - self.head.vertices
        return block.unposed.copy()

    def _without_expression(self, block: _Block) -> NDArray:
        """M of eq. 7 (f, n, 3)."""
        rests = self._at_rest(block)
        if block.psi is not None and block.psi.shape[1]:
            rests -= _weighted(block.psi, self.head.expression_basis)
        return rests


_REST = {"placement": np.eye(4), "alpha": 1.0}
"""Where coefficients stand that nobody solved for or held; the others at 0."""


def _weighted(weights: NDArray, basis: NDArray) -> NDArray:
    """(f, n, 3) in the basis's precision."""
    flat = weights.astype(basis.dtype) @ basis[: weights.shape[1]].reshape(weights.shape[1], basis[0].size)
    return flat.reshape(len(weights), *basis.shape[1:])


def _fitted(fitter: _BlockFitter, meshes: NDArray, held: Mapping[str, NDArray]) -> _Found:
    """All blocks, and what was found of each frame."""
    head, f = fitter.head, len(meshes)
    shapes = {"theta": (len(JOINTS), 3), "placement": (4, 4), "tau": (), "alpha": ()}
    shapes |= {"psi": (len(head.expression_basis),), "phi": (len(head.speech_basis),)}
    curves = {name: np.full((f, *shape), np.nan) for name, shape in shapes.items()}
    measured = np.zeros(f, bool)
    for chosen in in_blocks(f, BLOCK):
        chunk = np.asarray(meshes[chosen])
        fine = np.isfinite(chunk).all(axis=(1, 2))
        if not fine.any():
            continue
        frames = chosen.start + np.flatnonzero(fine)
        block = _Block(chunk[fine], {name: values[frames] for name, values in held.items() if name != "beta"})
        fitter.fit(block)
        measured[frames] = True
        for name, values in curves.items():
            own = getattr(block, name)
            values[frames] = _REST.get(name, 0.0) if own is None else own
    if not measured.any():
        raise InputError(
            f"none of {f} meshes is finite",
            expected="at least one tracked frame",
            remedy="Check the tracker's report of this take.",
        )
    curves["tau_m"] = curves.pop("tau")
    return _Found(curves, measured)


def _smoothed(found: _Found, stages: tuple[str, ...], time_s: NDArray, prior: TemporalPrior) -> _Found:
    """What was solved for, under a temporal prior; for tau a frame counts by alpha squared, its data term's Hessian."""
    curves, weights = dict(found.curves), found.measured.astype(float)
    if "pose" in stages:
        curves["theta"] = smoothed(curves["theta"], time_s, prior, weights)
        curves["placement"] = smoothed_placements(curves["placement"], time_s, prior, weights)
    for stage, name in (("expression", "psi"), ("speech", "phi")):
        if stage in stages and curves[name].shape[1]:
            curves[name] = smoothed(curves[name], time_s, prior, weights)
    if "larynx" in stages:
        told = np.where(weights > 0, np.nan_to_num(curves["alpha"]) ** 2, 0.0)
        if told.any():
            curves["tau_m"] = smoothed(curves["tau_m"], time_s, prior, told)
        curves["alpha"] = smoothed(curves["alpha"], time_s, prior, weights)
    return replace(found, curves=curves)


def _errors(model: NeckModel, person: NeckPerson, meshes: NDArray, found: _Found, seen) -> NDArray[np.float64]:
    """(f,) millimetres over the neck; NaN where there is no mesh to judge by."""
    head = model.head.personal(person.base)
    region = head.regions["neck"] if seen is None else head.regions["neck"] & seen
    neck, curves, out = np.flatnonzero(region), found.curves, np.full(len(meshes), np.nan)
    part = model_of_vertices(head, neck)
    inside = np.isin(person.larynx.vertices, neck)
    places = np.searchsorted(neck, person.larynx.vertices[inside])
    for chosen in in_blocks(len(meshes), BLOCK):
        frames = chosen.start + np.flatnonzero(found.measured[chosen] & np.isfinite(curves["tau_m"][chosen]))
        if not len(frames):
            continue
        own = {name: values[frames] for name, values in curves.items()}
        moved = person.larynx.offset(own["tau_m"], own["alpha"]).values[:, inside]
        posed = HeadCoefficients(None, own["psi"], own["theta"], own["phi"], own["placement"])
        shown = part.evaluate(posed, RestOffset(places, moved.astype(part.vertices.dtype)))[:, : len(neck)]
        observed = np.asarray(meshes[chosen])[frames - chosen.start][:, neck]
        out[frames] = 1e3 * np.linalg.norm(shown - observed, axis=-1).mean(axis=-1)
    return out


def _check(head: HeadModel, person: NeckPerson | None, frames: int, order: Sequence[str], held: Mapping[str, NDArray]) -> None:
    stage_of = {name: stage for stage, names in COEFFICIENTS.items() for name in names}
    unknown = [name for name in order if name not in COEFFICIENTS] + [name for name in held if name not in stage_of]
    if unknown:
        known = f"stages {', '.join(COEFFICIENTS)}; held coefficients {', '.join(stage_of)}"
        raise _refused(f"{unknown[0]!r} to fit or to hold", known, "Correct the name.")
    for stage, names in COEFFICIENTS.items():
        given = [name for name in names if name in held]
        if given and stage in order:
            raise _refused(f"{given[0]} held and the {stage} stage in the order", "one of both", "Leave one of them out.")
        if given and len(given) < len(names):
            raise _refused(f"{given[0]} held alone", f"{' and '.join(names)} together", "Give both, or solve for both.")
    if "identity" in order[1:] or ("identity" in order or "beta" in held) != (person is None):
        found = "no person" if person is None else "an identity stage or beta beside a person, or not at the first place"
        raise _refused(found, "a person, or beta held, or the identity stage first", "Name the person, or fit them first.")
    shapes = {"theta": (frames, 2, 3), "placement": (frames, 4, 4), "tau": (frames,), "alpha": (frames,)}
    shapes |= {
        "beta": (len(head.shape_basis),),
        "psi": (frames, len(head.expression_basis)),
        "phi": (frames, len(head.speech_basis)),
    }
    for name, values in held.items():
        if values.shape != shapes[name] or not np.isfinite(values).all():
            raise _refused(f"held {name} is {values.shape}, or not finite", f"{shapes[name]}, finite", "Give one row per frame.")


def _refused(found: str, expected: str, remedy: str) -> InputError:
    return InputError(found, expected=expected, remedy=remedy)
