"""What a neck model says of takes: coefficients of every frame, and how far the model is off."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import load_arrays, save_arrays
from headcap.neck.speech_fitting import SpeechFit

KIND, SCHEMA = "neck_fits", 1


@dataclass(frozen=True, eq=False)
class TakeFit:
    """One take of f frames; frames whose mesh was not finite are NaN."""

    take: str
    time_s: NDArray[np.float64]
    """(f,) on the take's common clock."""
    speech: SpeechFit
    theta: NDArray[np.float64]
    """(f, 2, 3) rotation vectors of neck and jaw, radians."""
    psi: NDArray[np.float64]
    """(f, e) expression."""
    placement: NDArray[np.float64]
    """world_from_head (f, 4, 4)."""
    base_error_mm: NDArray[np.float64]
    """(f,) mean vertex error of the neck at rest with pose and expression alone."""
    error_mm: NDArray[np.float64]
    """(f,) the same with larynx and speech blendshapes."""


@dataclass(frozen=True, eq=False)
class NeckFits:
    """All fitted takes of one person."""

    person: str
    takes: tuple[TakeFit, ...]

    def figures(self) -> dict[str, float]:
        """Errors over all frames (section 7.1) and how much the speech parts lower them (table 1), on the takes trained on."""
        base = np.nanmean(np.concatenate([take.base_error_mm for take in self.takes]))
        ours = np.nanmean(np.concatenate([take.error_mm for take in self.takes]))
        tau = np.concatenate([take.speech.tau_m for take in self.takes])
        return {
            "neck.base_error_mm": float(base),
            "neck.error_mm": float(ours),
            "neck.speech_error_drop_mm": float(base - ours),
            "neck.slide_range_mm": float(1e3 * (np.nanpercentile(tau, 95) - np.nanpercentile(tau, 5))),
        }

    def save(self, path: Path | str) -> None:
        """Write as npz artifact `headcap.neck_fits/1`."""
        arrays = {f"{k}/{name}": array for k, take in enumerate(self.takes) for name, array in _arrays(take).items()}
        save_arrays(path, KIND, SCHEMA, arrays, {"person": self.person, "takes": [take.take for take in self.takes]})

    @classmethod
    def load(cls, path: Path | str) -> NeckFits:
        """Read what `save` wrote; raises `ArtifactError`."""
        arrays, meta = load_arrays(path, KIND, SCHEMA)
        takes = []
        for k, name in enumerate(meta["takes"]):
            own = {key.removeprefix(f"{k}/"): array for key, array in arrays.items() if key.startswith(f"{k}/")}
            speech = SpeechFit(own.pop("tau_m"), own.pop("alpha"), own.pop("phi"))
            takes.append(TakeFit(take=name, speech=speech, **own))
        return cls(meta["person"], tuple(takes))


def _arrays(take: TakeFit) -> dict[str, NDArray]:
    speech = {name: getattr(take.speech, name) for name in ("tau_m", "alpha", "phi")}
    names = ("time_s", "theta", "psi", "placement", "base_error_mm", "error_mm")
    return speech | {name: getattr(take, name) for name in names}
