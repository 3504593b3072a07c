"""A new person under a trained neck model: base shape, weight map and direction with the speech blendshapes held (section 5.2).

The paper fits people it has not trained on with the model as it is and leaves open whose W they get. Here it is their own: first
from the neutral head (eq. 8 to 10), then, where they speak, by the steps of Algorithm 1 that concern one person's larynx.
Measured on two rehearsed people held out of a model of three others: the neutral head alone gives slides that correlate with the
truth by 0.998 and 0.999 and an error of 0.091 and 0.072 mm over the neck; one round makes it 0.073 and 0.061 mm at 0.995 and
0.999; two more lower the error by 0.003 mm and the first correlation to 0.986, for W then takes up what N lacks of this person.
Hence one round.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from headcap.neck.fitting.compensation import check_topology
from headcap.neck.fitting.speech import anchored, checked_mask, seen_directions, seen_larynx
from headcap.neck.frame_blocks import in_blocks
from headcap.neck.larynx.base_shape import Throat
from headcap.neck.larynx.chart import build_chart
from headcap.neck.larynx.coefficients import Nuisance, SlideSettings, slide_and_scale
from headcap.neck.larynx.larynx_map import FORWARD, LarynxMap, larynx_map
from headcap.neck.larynx.update import LarynxUpdateSettings, SlideSums, update_larynx
from headcap.neck.model import NeckModel, NeckPerson
from headcap.neck.subjects import NeckSubject

BLOCK = 128
"""Frames read at once: 20 MB at 13 thousand vertices."""
LEAST_FRAMES = 20
"""Fewer frames of speech than this say less of the larynx than the neutral head does."""


class PersonFittingSettings(BaseModel):
    """A new person's larynx model."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    rounds: int = Field(1, ge=0, description="Rounds of coefficients and larynx update on speech; 0: the neutral head alone")
    most_frames: int = Field(3000, ge=1, description="Speech frames that are used, evenly spaced: what bounds memory and time")
    settled: float = Field(1e-3, ge=0, description="A round that lowers the energy by a smaller share is the last")
    slide: SlideSettings = Field(default_factory=SlideSettings)
    update: LarynxUpdateSettings = Field(default_factory=LarynxUpdateSettings)


def fit_person(
    model: NeckModel,
    subject: NeckSubject,
    rests: NDArray | None = None,
    settings: PersonFittingSettings | None = None,
    *,
    progress: Callable[[str, float], None] | None = None,
) -> NeckPerson:
    """Base shape and larynx of a person that the model was not trained on; tau = 0, alpha = 1 are their neutral head; N is held.

    `rests` (f, n, 3) are their speech takes at rest, free of pose and expression (eq. 7), metres, in memory or read when indexed
    by frames; frames that are not finite are left out. From the neutral head by eq. 8 to 10; then rounds of eq. 12, 13 and 20 and
    of eq. 14 to 19, which `progress` is told of by step and energy (squared metres: squared distance over the seen vertices plus
    eq. 16 and 18), which never rises: a round that would is not taken. Without speech, or with fewer than 20 frames of it, the
    neutral head alone serves. What `subject.seen` leaves out tells nothing. Memory does not grow with f. Raises
    `InputError` for another topology.
    """
    settings = settings or PersonFittingSettings()
    check_topology(model.head, np.asarray(subject.neutral)[None])
    neutral = NeckPerson.of(subject.name, subject.neutral, model.head.triangles, empty_larynx(model))
    if rests is None or len(rests) == 0 or settings.rounds == 0:
        return neutral
    check_topology(model.head, rests)
    spoken = _spoken(model, subject, neutral, rests, settings)
    if len(spoken.throats) < LEAST_FRAMES:
        return neutral
    return _refined(spoken, neutral, settings, progress)


def empty_larynx(model: NeckModel) -> LarynxMap:
    """The larynx map of a neck model's topology without weights: the layout that its people have, a new one where it has none."""
    if model.people:
        layout = model.people[0].larynx
        return layout.with_weights(np.zeros_like(layout.weights_m), FORWARD)
    return larynx_map(model.head, build_chart(model.head))


@dataclass(eq=False)
class _Spoken:
    """Speech frames of one person: the throat whole, the rest by what N sees of it."""

    throat: Throat
    neutral: NDArray
    """(n, 3)."""
    throats: NDArray[np.float32]
    """(f, k, 3) metres."""
    outside: NDArray[np.float64]
    """(f, q) product of what lies outside L with the directions of N."""
    energy: float
    """Squared offsets outside L."""
    inside: NDArray[np.float64]
    """(q, k, 3) directions of N on L."""
    seen: NDArray[np.bool_]
    """(k,) of L."""
    base: NDArray = field(repr=False)
    larynx: LarynxMap = field(repr=False)
    tau: NDArray = field(default_factory=lambda: np.zeros(0))
    alpha: NDArray = field(default_factory=lambda: np.zeros(0))
    weights: NDArray = field(default_factory=lambda: np.zeros((0, 0)))
    """(f, q) of the directions of N."""

    def blocks(self) -> Iterator[slice]:
        """Frames in blocks."""
        return in_blocks(len(self.throats), BLOCK)

    def solve(self, settings: SlideSettings) -> None:
        """Eq. 12, 13 and 20 for every frame; a tau of the round before stays where it explains more."""
        f, before = len(self.throats), self.tau
        tau, alpha, weights = np.empty(f), np.empty(f), np.empty((f, len(self.inside)))
        larynx = self.shown
        for chosen in self.blocks():
            offsets = self.throats[chosen] - self.base
            product = self.outside[chosen] + np.einsum("fki,qki->fq", offsets, self.inside, optimize=True)
            nuisance = Nuisance(self.inside @ larynx.direction, product)
            kept = before[chosen] if len(before) else None
            tau[chosen], alpha[chosen] = slide_and_scale(offsets, larynx, settings, nuisance, kept)
            moved = larynx.offset(tau[chosen], alpha[chosen]).values
            weights[chosen] = product - np.einsum("fki,qki->fq", moved, self.inside, optimize=True)
        self.tau, self.alpha, self.weights = tau, alpha, weights

    def update(self, settings: LarynxUpdateSettings) -> None:
        """Eq. 14 to 19. An unseen vertex is taken to be where the model has it: it pulls at nothing."""
        sums = SlideSums.over(self.larynx, self.tau.min(), self.tau.max(), 1e-3 * settings.bin_mm)
        for chosen in self.blocks():
            bare = self.throats[chosen] - np.tensordot(self.weights[chosen], self.inside, axes=1)
            if not self.seen.all():
                moved = self.larynx.offset(self.tau[chosen], self.alpha[chosen]).values
                bare = np.where(self.seen[:, None], bare, self.base + moved)
            sums.add(bare, self.tau[chosen], self.alpha[chosen])
        self.base, self.larynx = update_larynx(sums, self.throat, self.base, settings)

    @property
    def shown(self) -> LarynxMap:
        """The larynx on seen vertices."""
        whole = np.ones(len(self.neutral), bool)
        whole[self.larynx.vertices] = self.seen
        return seen_larynx(self.larynx, None if self.seen.all() else whole)

    def total(self, settings: LarynxUpdateSettings) -> float:
        """Squared error over what was seen, and the weighted terms of eq. 16 and 18."""
        error, larynx = self.energy, self.shown
        for chosen in self.blocks():
            left = self.throats[chosen] - self.base - larynx.offset(self.tau[chosen], self.alpha[chosen]).values
            left = np.where(self.seen[:, None], left, 0.0)
            weights = self.weights[chosen]
            product = self.outside[chosen] + np.einsum("fki,qki->fq", left, self.inside, optimize=True)
            # |left - weights Q|^2 over L and outside, Q orthonormal
            error += float((left**2).sum() - 2 * (product * weights).sum() + (weights**2).sum())
        stiff = settings.laplacian * self.throat.roughness(self.base) + settings.boundary * self.throat.border_error(self.base)
        return error + len(self.throats) * stiff


def _spoken(
    model: NeckModel, subject: NeckSubject, neutral: NeckPerson, rests: NDArray, settings: PersonFittingSettings
) -> _Spoken:
    """What a person's speech frames say, read block by block."""
    head, vertices = model.head, neutral.larynx.vertices
    n = len(head.vertices)
    seen = checked_mask(subject.seen, n)
    seen = np.ones(n, bool) if seen is None else seen
    rows = seen_directions(np.asarray(head.speech_basis, float), seen)[0].reshape(-1, n, 3)
    inside = rows[:, vertices]
    rest = np.setdiff1d(np.flatnonzero(seen), vertices)
    beyond = rows[:, rest].reshape(len(rows), -1)
    throats, products, energy = [], [], 0.0
    frames = np.unique(np.linspace(0, len(rests) - 1, min(len(rests), settings.most_frames)).round().astype(np.int64))
    for chosen in in_blocks(len(frames), BLOCK):
        block = np.asarray(rests[frames[chosen]])
        block = block[np.isfinite(block).all(axis=(1, 2))]
        away = (block[:, rest] - subject.neutral[rest]).reshape(len(block), 3 * len(rest))
        throats.append(block[:, vertices].astype(np.float32))
        products.append(away @ beyond.T)
        energy += float(np.einsum("fc,fc->", away, away, dtype=np.float64))
    throat = Throat.of(subject.neutral, head.triangles, neutral.larynx)
    parts = (np.concatenate(throats), np.concatenate(products), energy, inside, seen[vertices])
    return _Spoken(throat, np.asarray(subject.neutral, float), *parts, neutral.base[vertices], neutral.larynx)


def _refined(
    spoken: _Spoken, neutral: NeckPerson, settings: PersonFittingSettings, progress: Callable[[str, float], None] | None
) -> NeckPerson:
    """Rounds of coefficients and larynx update until nothing more is gained."""
    tell = progress or (lambda step, energy: None)
    spoken.solve(settings.slide)
    energy = spoken.total(settings.update)
    tell("larynx coefficients", energy)
    best = spoken.base, spoken.larynx
    for _ in range(settings.rounds):
        spoken.update(settings.update)
        updated = spoken.total(settings.update)
        if not updated < energy:
            break
        tell("larynx model", updated)
        spoken.solve(settings.slide)
        found = spoken.total(settings.update)
        best = spoken.base, spoken.larynx
        tell("larynx coefficients", found)
        gained, energy = energy - found, found
        if gained < settings.settled * energy:
            break
    return anchored(neutral.name, spoken.neutral, *best, settings.slide)[0]
