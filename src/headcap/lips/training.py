"""Regressors of a study's lips: whom and what each is trained on (lip paper, sections 5.2 and 6)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from headcap.lips.correction import Identity
from headcap.lips.examples import LipExample, resting_distances
from headcap.lips.mouth import MouthSettings
from headcap.lips.regression import Inputs, RegressionSettings


class LipTrainingSettings(BaseModel):
    """Training lip regressors on a study's people."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    test_takes: tuple[str, ...] = Field(
        default=(),
        description="Takes of these names test regressors of people who train others; only GR for strangers learns them.",
    )
    mouth: MouthSettings = MouthSettings()
    regression: RegressionSettings = RegressionSettings()
    anchored: bool = Field(default=True, description="Contour distances count from the person's own at rest.")
    compensate_rotation: bool = Field(default=True, description="Contour distances are taken on the head, not in the picture.")


@dataclass(frozen=True)
class RegressorPlan:
    """One regressor of a study."""

    name: str
    people: tuple[str, ...]
    """Whom it is trained on."""
    all_takes: bool = False
    """Whether test takes train it too: where those whom it is tested on are none of its people."""
    kind: str = "rbf"
    inputs: Inputs = "combined"

    @property
    def settings(self) -> dict[str, str]:
        """What differs from the study's regression settings."""
        persons = {"leave_out": "persons"} if len(self.people) > 2 else {}
        return {"kind": self.kind, "inputs": self.inputs} | persons

    @property
    def identity(self) -> Identity:
        """D_0 of eq. 1: a stranger's neutral mouth is only known as the base tracker sees it, see `CorrectionLayer`."""
        return "kept" if self.all_takes else "corrected"


def planned_regressors(people: Sequence[str]) -> tuple[RegressorPlan, ...]:
    """Regressors of people who train: GR for strangers with its baselines, MS of them all, PS of each (section 6).

    Baselines are the affine regressor, and features of one kind alone (tables 2 and 3).
    """
    everybody = tuple(people)
    generic = [
        RegressorPlan("generic", everybody, all_takes=True),
        RegressorPlan("generic_affine", everybody, all_takes=True, kind="affine"),
        RegressorPlan("generic_shape", everybody, all_takes=True, inputs="shape"),
        RegressorPlan("generic_distances", everybody, all_takes=True, inputs="distances"),
    ]
    several = [RegressorPlan("several", everybody)] if len(people) > 1 else []
    return (*generic, *several, *(RegressorPlan(f"of_{name}", (name,)) for name in people))


@dataclass(frozen=True, eq=False)
class LipPerson:
    """One person's takes with their truth."""

    name: str
    neutral: NDArray[np.float64]
    """H_0 (n, 3) metres, at rest."""
    examples: Mapping[str, LipExample]
    truth: Mapping[str, NDArray]
    """H_f (f, n, 3) of the same frames by take, metres, in any frame; may be memory maps."""

    def rest(self) -> NDArray[np.float64]:
        """(20,) contour distances at rest, over all takes."""
        return resting_distances(list(self.examples.values()))
