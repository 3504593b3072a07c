"""Algorithm 1 of the neck paper (section 5.2): larynx model, larynx coefficients, speech blendshapes and weights in turn.

Several subjects share the speech blendshapes N and have their own T_0, W and t_s. Their meshes are free of pose and expression
(eq. 7) and are read in blocks: memory holds each frame's larynx region and a few hundred numbers for the rest of it.

Speech blendshapes are leading singular vectors of what the larynx leaves (section 5.2, "Blendshape update", eq. 3, 20). Outside
the larynx region a frame's residual M_j - T_0 is the same in every iteration (N(T_0) = N(T)). It is therefore reduced once to
its leading coordinates; inside, the residual itself is kept. The basis of these coordinates is orthonormal, so singular vectors
of the reduced matrix are those of the whole one, up to what the reduction left out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from headcap.errors import InputError
from headcap.geometry.leading_directions import leading_directions, reduce_rows
from headcap.heads import HeadModel
from headcap.meshes.extension import SmoothExtension
from headcap.neck.fitting.speech import SpeechFit, anchored, spread
from headcap.neck.frame_blocks import in_blocks
from headcap.neck.larynx.base_shape import Throat, initial_larynx
from headcap.neck.larynx.coefficients import Nuisance, SlideSettings, slide_and_scale
from headcap.neck.larynx.larynx_map import LarynxMap
from headcap.neck.larynx.update import LarynxUpdateSettings, SlideSums, update_larynx
from headcap.neck.model import NeckModel, NeckPerson
from headcap.neck.training_subject import seen_by_all

LEAST_FRAMES = 8
"""Of each subject: two for each of the three numbers that place and shape a larynx, and two to spare."""

BLOCK = 512
"""Frames read at once: 80 MB at 13 thousand vertices."""


class SpeechTrainingSettings(BaseModel):
    """Algorithm 1."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    iterations: int = Field(10, ge=1, description="Iterations; the basis grows in each")
    growth: int = Field(2, ge=1, description="Blendshapes added per iteration")
    reduced: int = Field(100, ge=1, description="Coordinates kept of what lies outside the larynx region")
    slide: SlideSettings = Field(default_factory=SlideSettings)
    update: LarynxUpdateSettings = Field(default_factory=LarynxUpdateSettings)


@dataclass(frozen=True, eq=False)
class SpeechSubject:
    """One person's speech takes, free of pose and expression, at rest."""

    name: str
    neutral: NDArray
    """(n, 3) metres: neutral pose, neutral expression, silent."""
    meshes: NDArray
    """(f, n, 3) metres; may be memory-mapped."""
    seen: NDArray[np.bool_] | None = None
    """(n,) vertices that cameras saw, all by default: what a tracker makes up elsewhere is not learnt from."""


@dataclass(frozen=True, eq=False)
class SpeechTraining:
    """Result of Algorithm 1."""

    model: NeckModel
    """With N ordered by variance, and orthonormal over what was seen of all people."""
    fits: dict[str, SpeechFit]
    """Coefficients of each subject's frames; frames that were not finite are NaN."""
    energy: tuple[tuple[str, float], ...]
    """Each step's name and the energy after it: squared error plus weighted terms of eq. 14, square metres."""


def train_speech(
    model: HeadModel,
    empty: LarynxMap,
    subjects: Sequence[SpeechSubject],
    settings: SpeechTrainingSettings | None = None,
    *,
    progress: Callable[[str, float], None] | None = None,
) -> SpeechTraining:
    """Train the speech part of a head model on one or several subjects' meshes by Algorithm 1.

    `empty` is the model's larynx map without weights. The paper leaves tau = 0, alpha = 1 until the first larynx update, which
    smears the weight map over a moving larynx; here eq. 12 and 13 are solved with the neutral head's weights first, and with
    second-order polynomials over the chart in place of the blendshapes that are not there yet. On rehearsed throats whose skin
    moves more than the larynx lifts it, slides correlate with the truth by 0.98; by 0.81 to 0.89 without the polynomials.
    The larynx region is taken as seen; where some subject was not seen outside it, N is continued smoothly.
    Raises `InputError` for too few frames, another topology or meshes that are not finite.
    """
    settings = settings or SpeechTrainingSettings()
    for subject in subjects:
        _check(subject, model)
    _check_frames(subjects, settings)
    run = _Run(model, empty, subjects, settings, progress)
    run.estimate_slides()
    run.grow()
    for _ in range(settings.iterations - 1):
        run.update_larynges()
        run.estimate_slides()
        run.grow()
    return run.result()


def _check(subject: SpeechSubject, model: HeadModel) -> None:
    n = len(model.vertices)
    if subject.neutral.shape != (n, 3) or subject.meshes.shape[1:] != (n, 3):
        raise InputError(
            f"subject {subject.name}: neutral {subject.neutral.shape}, meshes {subject.meshes.shape}",
            expected=f"({n}, 3) and (frames, {n}, 3), the topology of {model.name}",
            remedy="Track the takes with this model's template.",
        )
    if len(subject.meshes) < LEAST_FRAMES:
        raise InputError(
            f"subject {subject.name}: {len(subject.meshes)} frames",
            expected=f"at least {LEAST_FRAMES}, to tell the larynx from the throat it slides under",
            remedy="Record longer speech takes, or leave this subject out of the training.",
        )


def _check_frames(subjects: Sequence[SpeechSubject], settings: SpeechTrainingSettings) -> None:
    frames, least = sum(len(subject.meshes) for subject in subjects), 2 * settings.iterations * settings.growth
    if frames < least:
        raise InputError(
            f"{frames} frames of {', '.join(subject.name for subject in subjects) or 'nobody'}",
            expected=f"at least {least}, twice the speech blendshapes",
            remedy="Record longer speech takes or train fewer blendshapes.",
        )


@dataclass
class _Person:
    """One subject in the course of training."""

    subject: SpeechSubject
    frames: NDArray[np.int64]
    """(f,) frames that are finite."""
    throat: Throat
    base: NDArray
    larynx: LarynxMap
    throats: NDArray[np.float32]
    """(f, k, 3) L of each frame."""
    outside: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 0), np.float32))
    """(f, r) the rest of each frame, reduced."""
    tau: NDArray = field(default_factory=lambda: np.zeros(0))
    alpha: NDArray = field(default_factory=lambda: np.ones(0))
    phi: NDArray = field(default_factory=lambda: np.zeros((0, 0)))

    def blocks(self) -> Iterator[slice]:
        """Frames in blocks."""
        return in_blocks(len(self.frames), BLOCK)

    def residual(self, chosen: slice) -> NDArray[np.float32]:
        """(b, 3 k + r) what base and larynx leave of some frames."""
        moved = self.larynx.offset(self.tau[chosen], self.alpha[chosen]).values
        throat = (self.throats[chosen] - self.base - moved).reshape(len(moved), -1)
        return np.concatenate([throat.astype(np.float32), self.outside[chosen]], axis=1)


class _Run:
    """State of Algorithm 1."""

    def __init__(self, model, empty, subjects, settings: SpeechTrainingSettings, progress) -> None:
        self.model, self.settings, self.progress = model, settings, progress
        self.vertices = empty.vertices
        self.seen = seen_by_all(model, subjects)
        self.seen[self.vertices] = True
        self.rest = np.setdiff1d(np.flatnonzero(self.seen), self.vertices)
        self.people = [_person(subject, model, empty) for subject in subjects]
        self.energy: list[tuple[str, float]] = []
        self._reduce()
        self.basis = np.zeros((0, 3 * len(self.vertices) + self.people[0].outside.shape[1]))

    def estimate_slides(self) -> None:
        """Eq. 12 and 13 for every frame, then eq. 20 with the blendshapes there are."""
        for person in self.people:
            tau, alpha, began = *np.empty((2, len(person.frames))), bool(self.energy)
            for chosen in person.blocks():
                offsets = person.throats[chosen] - person.base
                nuisance = self._nuisance(person, chosen, offsets)
                before = person.tau[chosen] if began else None
                tau[chosen], alpha[chosen] = slide_and_scale(offsets, person.larynx, self.settings.slide, nuisance, before)
            person.tau, person.alpha = tau, alpha
        self._solve_weights()
        self._note("larynx coefficients")

    def _nuisance(self, person: _Person, chosen: slice, offsets: NDArray) -> Nuisance:
        """The speech blendshapes; before there are any, smooth motion of the throat."""
        if not len(self.basis):
            return Nuisance.smooth(np.asarray(offsets, float) @ person.larynx.direction, person.larynx)
        width = 3 * len(self.vertices)
        throat = self.basis[:, :width].reshape(len(self.basis), -1, 3) @ person.larynx.direction
        whole = np.concatenate([offsets.reshape(len(offsets), -1), person.outside[chosen]], axis=1)
        return Nuisance(throat, whole @ self.basis.T)

    def _solve_weights(self) -> None:
        """Eq. 20 for every frame: the basis is orthonormal."""
        for person in self.people:
            person.phi = np.concatenate([person.residual(chosen) @ self.basis.T for chosen in person.blocks()])

    def grow(self) -> None:
        """The blendshape update with a larger basis, and eq. 20."""
        count = len(self.basis) + self.settings.growth
        # kept for all passes of the search: as large as the throats themselves
        residuals = [person.residual(chosen) for person in self.people for chosen in person.blocks()]
        self.basis = leading_directions(lambda: residuals, self.basis.shape[1], count, start=self.basis).vectors
        self._solve_weights()
        self._note("speech blendshapes")

    def update_larynges(self) -> None:
        """Eq. 14 to 19 for every subject."""
        width, update = 3 * len(self.vertices), self.settings.update
        for person in self.people:
            sums = SlideSums.over(person.larynx, person.tau.min(), person.tau.max(), 1e-3 * update.bin_mm)
            for chosen in person.blocks():
                sums.add(person.throats[chosen] - self._spoken(person, chosen, width), person.tau[chosen], person.alpha[chosen])
            person.base, person.larynx = update_larynx(sums, person.throat, person.base, update)
        self._note("larynx model")

    def result(self) -> SpeechTraining:
        """In the terms of the head model."""
        width, count = 3 * len(self.vertices), len(self.basis)
        whole = np.zeros((count, len(self.model.vertices), 3))
        whole[:, self.vertices] = self.basis[:, :width].reshape(count, -1, 3)
        whole[:, self.rest] = (self.basis[:, width:] @ self.directions).reshape(count, -1, 3)
        whole = SmoothExtension(self.model.vertices, self.model.triangles, self.seen)(whole)
        head = replace(self.model, speech_basis=whole.astype(self.model.vertices.dtype))
        people, fits = zip(*(self._anchored(person) for person in self.people), strict=True)
        return SpeechTraining(
            NeckModel(head, people), {p.name: fit for p, fit in zip(people, fits, strict=True)}, tuple(self.energy)
        )

    def _anchored(self, person: _Person) -> tuple[NeckPerson, SpeechFit]:
        """With alpha = 1 on the neutral head, as eq. 1 has it."""
        subject, slide = person.subject, self.settings.slide
        found, scale = anchored(subject.name, subject.neutral, person.base, person.larynx, slide)
        known = np.isin(np.arange(len(person.subject.meshes)), person.frames)
        values = (person.tau, person.alpha / scale, person.phi)
        return found, SpeechFit(*(spread(v, known) for v in values))

    def _spoken(self, person: _Person, chosen: slice, width: int) -> NDArray:
        """B_N on L (b, k, 3)."""
        if not len(self.basis):
            return np.zeros((1, 1, 3))
        return (person.phi[chosen] @ self.basis[:, :width]).reshape(-1, width // 3, 3)

    def _reduce(self) -> None:
        """Outside L: leading coordinates of the frames' offsets from the neutral head."""

        def offsets() -> Iterator[NDArray]:
            """Blocks (f, c) over all people."""
            for person in self.people:
                neutral = person.subject.neutral[self.rest].astype(np.float32)
                for chosen in person.blocks():
                    block = person.subject.meshes[person.frames[chosen]][:, self.rest] - neutral
                    yield np.ascontiguousarray(block, np.float32).reshape(len(block), -1)

        frames = sum(len(person.frames) for person in self.people)
        count = min(self.settings.reduced, frames, 3 * len(self.rest))
        reduced, self.directions, self.left_out = reduce_rows(offsets, 3 * len(self.rest), count)
        for person in self.people:
            person.outside, reduced = reduced[: len(person.frames)], reduced[len(person.frames) :]

    def _note(self, step: str) -> None:
        total = self.left_out
        update = self.settings.update
        for person in self.people:
            for chosen in person.blocks():
                left = person.residual(chosen)
                if len(self.basis):
                    left = left - person.phi[chosen] @ self.basis
                total += float(np.einsum("fc,fc->", left, left, dtype=np.float64))
            total += len(person.frames) * (
                update.laplacian * person.throat.roughness(person.base)
                + update.boundary * person.throat.border_error(person.base)
            )
        self.energy.append((step, total))
        if self.progress is not None:
            self.progress(step, total)


def _person(subject: SpeechSubject, model: HeadModel, empty: LarynxMap) -> _Person:
    throat = Throat.of(subject.neutral, model.triangles, empty)
    base, larynx = initial_larynx(throat, empty)
    frames = np.flatnonzero(np.concatenate([_finite(subject.meshes[c]) for c in in_blocks(len(subject.meshes), BLOCK)]))
    throats = np.concatenate([subject.meshes[frames[c]][:, empty.vertices] for c in in_blocks(len(frames), BLOCK)])
    person = _Person(subject, frames, throat, base, larynx, throats.astype(np.float32))
    person.tau, person.alpha = np.zeros(len(frames)), np.ones(len(frames))
    person.phi = np.zeros((len(frames), 0))
    return person


def _finite(meshes: NDArray) -> NDArray[np.bool_]:
    return np.isfinite(meshes).all(axis=(1, 2))
