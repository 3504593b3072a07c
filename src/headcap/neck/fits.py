"""What a neck model says of takes: coefficients of every frame, and how far the model is off at each stage of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import load_arrays, save_arrays
from headcap.errors import InputError
from headcap.neck.fitting.speech import SpeechFit

KIND, SCHEMA = "neck_fits", 2

STAGES = ("base", "pose", "expression", "full", "without_larynx", "without_speech")
"""Whose errors a take may hold: the head model before section 5.1's training; pose correctives trained; expressions too; the
whole model; the same with the larynx still at rest (tau = 0, alpha = 1), phi fitted to that; larynx alone, fitted without N."""
_WHOLE = ("full", "expression", "pose", "base")
"""Best first."""
_ARRAYS = ("time_s", "theta", "psi", "placement")


@dataclass(frozen=True, eq=False)
class TakeFit:
    """One take of f frames; frames whose mesh was not finite are NaN."""

    take: str
    kind: str
    """What the person does: pose, expression, speech, lips or free."""
    time_s: NDArray[np.float64]
    """(f,) on the take's common clock."""
    speech: SpeechFit
    theta: NDArray[np.float64]
    """(f, 2, 3) rotation vectors of neck and jaw, radians."""
    psi: NDArray[np.float64]
    """(f, e) expression."""
    placement: NDArray[np.float64]
    """world_from_head (f, 4, 4)."""
    errors_mm: Mapping[str, NDArray[np.float64]]
    """(f,) mean 3D vertex error over the neck region (section 7.1) by stage, see `STAGES`; what a kind of take cannot show of
    them is absent."""

    def __post_init__(self) -> None:
        if not self.errors_mm or set(self.errors_mm) - set(STAGES):
            raise InputError(
                f"{self.take}: errors of {', '.join(self.errors_mm) or 'no stage'}",
                expected=f"some of {', '.join(STAGES)}",
                remedy="Name the stages as the fitting does.",
            )

    @property
    def base_error_mm(self) -> NDArray[np.float64]:
        """(f,) of the head model before training."""
        return self.errors_mm["base"]

    @property
    def error_mm(self) -> NDArray[np.float64]:
        """(f,) of all of the model that the take was fitted with."""
        return self.errors_mm[next(stage for stage in _WHOLE if stage in self.errors_mm)]


@dataclass(frozen=True, eq=False)
class NeckFits:
    """All fitted takes of one person."""

    person: str
    takes: tuple[TakeFit, ...]
    held_out: bool = False
    """True where the model was trained without this person."""

    def of_kind(self, *kinds: str) -> tuple[TakeFit, ...]:
        """The takes of some kinds."""
        return tuple(take for take in self.takes if take.kind in kinds)

    def mean_error_mm(self, stage: str, *kinds: str) -> float:
        """Mean over all fitted frames of takes of some kinds that hold the stage; NaN where there are none."""
        errors = [take.errors_mm[stage] for take in self.of_kind(*kinds) if stage in take.errors_mm]
        known = np.concatenate([error[np.isfinite(error)] for error in errors]) if errors else np.zeros(0)
        return float(known.mean()) if len(known) else float("nan")

    def figures(self) -> dict[str, float]:
        """Table 1's error drops, the parts that larynx and speech blendshapes have in them, and the larynx's slide (section 7.2).

        A drop is the error of the stage before minus the error after, each a mean over all frames of the takes that show it: pose
        takes the pose correctives, expression takes pose correctives and expressions, speech takes larynx and speech
        blendshapes. A figure is absent where the person has no such take. `neck.base_error_mm` and `neck.error_mm` are of speech
        takes (figure 7).
        """
        error = self.mean_error_mm
        values = {
            "neck.base_error_mm": error("base", "speech"),
            "neck.error_mm": error("full", "speech"),
            "neck.pose_error_drop_mm": error("base", "pose") - error("pose", "pose"),
            "neck.expression_error_drop_mm": error("base", "expression") - error("expression", "expression"),
            "neck.speech_error_drop_mm": error("expression", "speech") - error("full", "speech"),
            "neck.larynx_part_mm": error("without_larynx", "speech") - error("full", "speech"),
            "neck.speech_part_mm": error("without_speech", "speech") - error("full", "speech"),
            "neck.slide_range_mm": self._slide_range_mm(),
            "neck.skipped_frames": float(sum((~np.isfinite(take.error_mm)).sum() for take in self.takes)),
        }
        return {name: value for name, value in values.items() if np.isfinite(value)}

    def _slide_range_mm(self) -> float:
        """5th to 95th percentile over speech takes."""
        slides = [take.speech.tau_m[take.speech.known] for take in self.of_kind("speech")]
        tau = np.concatenate(slides) if slides else np.zeros(0)
        return float(1e3 * np.diff(np.percentile(tau, (5, 95)))[0]) if len(tau) else float("nan")

    def save(self, path: Path | str) -> None:
        """Write as npz artifact `headcap.neck_fits/2`."""
        arrays = {f"{k}/{name}": array for k, take in enumerate(self.takes) for name, array in _arrays(take).items()}
        takes = [{"name": take.take, "kind": take.kind} for take in self.takes]
        save_arrays(path, KIND, SCHEMA, arrays, {"person": self.person, "held_out": self.held_out, "takes": takes})

    @classmethod
    def load(cls, path: Path | str) -> NeckFits:
        """Read what `save` wrote; raises `ArtifactError`."""
        arrays, meta = load_arrays(path, KIND, SCHEMA)
        takes = []
        for k, record in enumerate(meta["takes"]):
            own = {key.removeprefix(f"{k}/"): array for key, array in arrays.items() if key.startswith(f"{k}/")}
            speech = SpeechFit(own["tau_m"], own["alpha"], own["phi"])
            errors = {key.removeprefix("errors_mm/"): array for key, array in own.items() if key.startswith("errors_mm/")}
            fitted = {name: own[name] for name in _ARRAYS}
            takes.append(TakeFit(take=record["name"], kind=record["kind"], speech=speech, errors_mm=errors, **fitted))
        return cls(meta["person"], tuple(takes), meta["held_out"])


def _arrays(take: TakeFit) -> dict[str, NDArray]:
    speech = {name: getattr(take.speech, name) for name in ("tau_m", "alpha", "phi")}
    errors = {f"errors_mm/{stage}": error for stage, error in take.errors_mm.items()}
    return speech | errors | {name: getattr(take, name) for name in _ARRAYS}
