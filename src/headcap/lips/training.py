"""Regressors of a study's lips: whom and what each is trained on, and what it does for a person (lip paper, section 6)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from headcap.lips.artifact import LipRegressor
from headcap.lips.contours import LipExample, MouthLocator, labelled_examples, load_labels, mesh_examples
from headcap.lips.contours.settings import ContourSettings, SearchSettings
from headcap.lips.features import LipFeatures
from headcap.lips.mesh_contours import MeshContours
from headcap.lips.mirroring import MouthMirror
from headcap.lips.mouth import MouthSettings
from headcap.lips.people import LipPerson, LipPersonFiles
from headcap.lips.regression import Inputs, LipTake, RegressionSettings, train_regression
from headcap.lips.takes import MouthSpace, SeenTake, resting_distances

GENERIC, SEVERAL = "generic", "several"


class LipTrainingSettings(BaseModel):
    """Training contour detector and lip regressors on a study's people."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    test_takes: tuple[str, ...] = Field(
        default=(),
        description="Takes of these names test people's own regressors and their common one, which learn the rest.",
    )
    pictures_per_take: int = Field(
        12, ge=1, description="Frames of each training take that the contour detector learns from, evenly spread"
    )
    labels: dict[str, dict[str, str]] = Field(
        default={},
        description="Files of lip contours drawn by hand, by person and take; frames are counted as in the take's base track. "
        "The contour detector learns from them in the place of what the take's true meshes show.",
    )
    contours: ContourSettings = ContourSettings()
    search: SearchSettings = SearchSettings()
    mouth: MouthSettings = MouthSettings()
    regression: RegressionSettings = RegressionSettings()
    mirrored: bool = Field(
        default=True,
        description="Whether strangers' regressors also learn from every take in a mirror, where the head model is symmetric. "
        "Of ten filmed people who all smirk to one side, one left out: with nine in training the rms error of expression falls "
        "from 0.37 to 0.36 mm, that on takes in a mirror (a smirk to the other side) from 0.61 to 0.39 mm",
    )
    identity_share: float | None = Field(
        default=None,
        ge=0,
        le=1,
        description="Share of the training people's mean D_0 that strangers' corrections begin with; found by leaving out each "
        "of them in turn where none is given",
    )


@dataclass(frozen=True)
class RegressorPlan:
    """One regressor of a study."""

    name: str
    relation: Literal["PS", "MS", "GR"]
    people: tuple[str, ...]
    """Whom it is trained on."""
    kind: Literal["rbf", "affine"] = "rbf"
    inputs: Inputs = "combined"

    @property
    def method(self) -> str:
        """What tables call it: its relation to those it is tested on, with a word of what is changed."""
        words = ("affine",) if self.kind == "affine" else () if self.inputs == "combined" else (self.inputs,)
        return " ".join((self.relation, *words))

    def settings(self, common: RegressionSettings) -> RegressionSettings:
        """The study's regression settings with what is this one's own."""
        leave_out = "persons" if self.relation == "GR" and len(self.people) > 1 else "takes"
        return common.model_copy(update={"kind": self.kind, "inputs": self.inputs, "leave_out": leave_out})

    def tests(self, person: str) -> bool:
        """Whether a person's takes test it."""
        return person not in self.people if self.relation == "GR" else person in self.people


def spread_frames(frames: int, count: int) -> frozenset[int]:
    """At most `count` frames of so many, evenly spread."""
    return frozenset(np.linspace(0, frames - 1, min(count, frames)).round().astype(int).tolist())


def contour_examples(person: LipPersonFiles, space: MouthSpace, settings: LipTrainingSettings) -> list[LipExample]:
    """A few frames of each of a person's takes, with the contours that their true meshes show there (section 3.2.2).

    The paper labels some frames by hand; the rig knows, and is asked in takes that nobody has labelled. Raises `InputError` as
    `LipPersonFiles.load`, `ClipFiles.open`, `load_labels` and `labelled_examples`.
    """
    model, locate = space.model, MouthLocator.of(space.mouth, space.features)
    see = MeshContours.of(np.asarray(model.vertices, float), space.mouth, model.regions)
    loaded, out = person.load(space, contours=False), []
    for take in person.takes:
        clip, known = take.clip.open(), loaded.takes[take.name]
        drawn = settings.labels.get(person.name, {}).get(take.name)
        if drawn is not None:
            base = known.seen.base
            out += labelled_examples(
                person.name, clip.pictures(), load_labels(drawn), base.world(base.meshes), clip.camera, locate
            )
            continue
        chosen = spread_frames(len(clip), settings.pictures_per_take)
        meshes = (np.asarray(mesh, float) if frame in chosen else None for frame, mesh in enumerate(known.truth()))
        out += mesh_examples(person.name, clip.pictures(), meshes, clip.camera, see, locate)
    return out


def planned_regressors(people: Sequence[str]) -> tuple[RegressorPlan, ...]:
    """Regressors of people who train: GR for strangers with its baselines, MS of them all, PS of each (section 6).

    Baselines are the affine regressor and features of one kind alone (tables 2 and 3, figure 16).
    """
    everybody = tuple(people)
    generic = [
        RegressorPlan(GENERIC, "GR", everybody),
        RegressorPlan(f"{GENERIC}_affine", "GR", everybody, kind="affine"),
        RegressorPlan(f"{GENERIC}_shape", "GR", everybody, inputs="shape"),
        RegressorPlan(f"{GENERIC}_distances", "GR", everybody, inputs="distances"),
    ]
    several = [RegressorPlan(SEVERAL, "MS", everybody)] if len(people) > 1 else []
    return (*generic, *several, *(RegressorPlan(f"of_{name}", "PS", (name,)) for name in people))


def train_lips(
    space: MouthSpace, people: Sequence[LipPerson], plan: RegressorPlan, settings: LipTrainingSettings
) -> LipRegressor:
    """One regressor of a study; raises `InputError` for too few frames.

    GR learns from all takes of its people, as strangers are seen: on the neutral head that the base tracker believes in, whose
    usual fault it mends (`common_identity`). MS and PS leave out test takes, and put the person's true neutral head in first
    (`SeenTake.known`), which the rig has measured.
    """
    chosen = [person for person in people if person.name in plan.people]
    left_out = () if plan.relation == "GR" else settings.test_takes
    takes = [take for person in chosen for take in _training_takes(person, plan, left_out)]
    how = plan.settings(settings.regression)
    mirror = MouthMirror.of(np.asarray(space.model.vertices, float), space.mouth, space.features)
    if plan.relation == "GR" and settings.mirrored and mirror is not None:
        takes += [mirror(take) for take in takes]
        # images have prototypes of their own: with no more of them than before, the side that everybody smirks to loses
        how = how.model_copy(update={"prototypes": 2 * how.prototypes})
    regression = train_regression(takes, how)
    constant = None
    if plan.relation == "GR":
        constant, share = common_identity(chosen, settings.identity_share)
        regression.figures["identity_share"] = share
    return LipRegressor(
        model_version=space.model.digest,
        topology=space.model.topology_digest,
        persons=plan.people,
        settings=how,
        mouth_settings=settings.mouth,
        layer=space.mouth.layer,
        identity="kept",
        anchored=True,
        compensate_rotation=True,
        space=space.features,
        regression=regression,
        identity_part=constant,
    )


def common_identity(people: Sequence[LipPerson], share: float | None = None) -> tuple[NDArray[np.float32], float]:
    """Nine numbers (T, 9) of the identity part of a stranger's correction, and the share of the people's mean D_0 that they are.

    Eq. 1 has a person's own D_0, which the rig has not measured of strangers. What can be told of theirs beforehand is where the
    base tracker errs on everybody: the mean D_0 of the training people, shrunk towards none. Unless given, the share is
    <u, v> / <v, v> within 0 and 1, with u what each person's tracked neutral mouth lacks and v what the mean of the other people
    puts in there: least squares on people left out, so that a tracker without such faults, or two people who contradict each
    other, leave nothing; one person alone leaves none.

    Measured on ten filmed people known from one frontal frame, neutral mouths of strangers: 3.50 mm off in place and 1.30 mm in
    shape; 3.21 and 1.22 with three people in training, 3.21 and 1.21 with four, 3.06 and 1.10 with six (share 0.98). Six people
    of ten gain; those whom the tracker sees best lose, by up to 1.6 mm in place. Where heads turn less is left to mend: 0.38.
    """
    lacking = {person.name: _mean_identity(person) for person in people}
    mean = np.mean(list(lacking.values()), axis=0, dtype=np.float32)
    if share is None:
        share = _share_for_strangers(people, lacking) if len(people) > 1 else 0.0
    return np.float32(share) * mean, float(share)


def _mean_identity(person: LipPerson) -> NDArray[np.float32]:
    return np.mean([take.seen.identity_difference(take.neutral) for take in person.takes.values()], axis=0)


def _share_for_strangers(people: Sequence[LipPerson], lacking: Mapping[str, NDArray]) -> float:
    along = length = 0.0
    for person in people:
        others = np.mean([part for name, part in lacking.items() if name != person.name], axis=0, dtype=np.float32)
        for take in person.takes.values():
            seen, mouth = take.seen, take.seen.space.mouth
            true = seen.known(take.neutral).neutral[mouth.vertices]
            moved = seen.layer().corrected(seen.neutral[None], others[None])[0][mouth.vertices] - seen.neutral[mouth.vertices]
            along += float((moved * (true - seen.neutral[mouth.vertices])).sum())
            length += float((moved**2).sum())
    return float(np.clip(along / length, 0, 1)) if length else 0.0


def as_seen_by(plan: RegressorPlan, person: LipPerson) -> dict[str, SeenTake]:
    """A person's takes as a regressor sees them, by name: with the true neutral head where it knows the person."""
    takes = {name: take.seen for name, take in person.takes.items()}
    if plan.relation == "GR":
        return takes
    return {name: seen.known(person.takes[name].neutral) for name, seen in takes.items()}


def anchored_features(takes: Mapping[str, SeenTake]) -> dict[str, LipFeatures]:
    """Features of a person's takes, distances as they differ from those at rest in all of the takes."""
    rest = resting_distances(list(takes.values()))
    return {name: seen.features.anchored(rest) for name, seen in takes.items()}


def regressed(regressor: LipRegressor, takes: Mapping[str, SeenTake]) -> dict[str, NDArray[np.float32]]:
    """l (f, T, 9) of a person's takes by name, told in the way the regressor was trained; NaN where a frame tells none."""
    turned = regressor.compensate_rotation
    seen = {
        name: take if take.compensate_rotation == turned else replace(take, compensate_rotation=turned)
        for name, take in takes.items()
    }
    features = anchored_features(seen) if regressor.anchored else {name: take.features for name, take in seen.items()}
    return {name: regressor.parameters(told) for name, told in features.items()}


def _training_takes(person: LipPerson, plan: RegressorPlan, left_out: Sequence[str]) -> list[LipTake]:
    seen = as_seen_by(plan, person)
    features = anchored_features(seen)
    return [
        LipTake(person.name, name, features[name], seen[name].parameters(take.neutral, take.true_meshes()))
        for name, take in person.takes.items()
        if name not in left_out
    ]
