"""What the tracker was left with in each frame, as it goes from chunks into the take's sequence and the report."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import load_json, save_json

KIND, SCHEMA = "track_residuals", 1


@dataclass(frozen=True)
class TrackResiduals:
    """Residuals by name over consecutive frames of one take."""

    take: str
    time_s: NDArray[np.float64]
    """(t,) on the take's common clock."""
    values: Mapping[str, NDArray[np.float64]]
    """(t,) each; the name ends in the unit where there is one."""

    def __post_init__(self) -> None:
        wrong = [name for name, values in self.values.items() if np.shape(values) != np.shape(self.time_s)]
        if wrong:
            raise ValueError(f"{', '.join(wrong)}: expected one value for each of {len(self.time_s)} frames")

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def worst(self) -> dict[str, float]:
        """Largest value over the frames by the name of its figure."""
        return {f"track.{name}": float(np.max(values)) for name, values in self.values.items()}

    @classmethod
    def of(cls, take: str, time_s: Iterable[float], values: Mapping[str, Iterable[float]]) -> TrackResiduals:
        """From plain lists, as the tracker gives them; raises ValueError where their lengths differ."""
        return cls(take, np.array(time_s, float), {name: np.array(column, float) for name, column in values.items()})

    @classmethod
    def joined(cls, parts: Iterable[TrackResiduals]) -> TrackResiduals:
        """Chunks of one take, in the order of time; raises ValueError where they are of several takes or differ in names."""
        parts = sorted(parts, key=lambda part: part.time_s[0])
        names = list(parts[0].values)
        if any(part.take != parts[0].take or list(part.values) != names for part in parts):
            raise ValueError(f"chunks of {sorted({part.take for part in parts})} do not make one take")
        columns = {name: np.concatenate([part.values[name] for part in parts]) for name in names}
        return cls(parts[0].take, np.concatenate([part.time_s for part in parts]), columns)

    def save(self, path: Path | str) -> None:
        """Write as JSON artifact `headcap.track_residuals/1`."""
        values = {name: np.asarray(column, float).tolist() for name, column in self.values.items()}
        save_json(path, KIND, SCHEMA, {"take": self.take, "time_s": self.time_s.tolist(), "values": values})

    @classmethod
    def load(cls, path: Path | str) -> TrackResiduals:
        """Read what `save` wrote; raises `ArtifactError`."""
        return cls.of(**load_json(path, KIND, SCHEMA))
