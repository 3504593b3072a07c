"""Start times of one take's recordings on a common clock."""

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import load_json, save_json

KIND, SCHEMA = "time_offsets", 1


@dataclass(frozen=True)
class TimeOffsets:
    """Common time of a recording's own time t is `start_s + (1 + drift_ppm * 1e-6) * t`."""

    take: str
    cameras: tuple[str, ...]
    start_s: tuple[float, ...]
    """Common time at which each recording's presentation time is zero."""
    drift_ppm: tuple[float, ...]
    confidence: tuple[float, ...]
    """0 to 1 per camera."""
    method: tuple[str, ...]
    """Per camera: clap, sound (of the whole recording), manual or none."""

    def common_time(self, camera: str, own_time_s: NDArray) -> NDArray:
        """Presentation times of one camera to the common clock, seconds."""
        c = self.cameras.index(camera)
        return self.start_s[c] + (1 + self.drift_ppm[c] * 1e-6) * np.asarray(own_time_s, float)

    def own_time(self, camera: str, common_time_s: NDArray) -> NDArray:
        """Inverse of `common_time`."""
        c = self.cameras.index(camera)
        return (np.asarray(common_time_s, float) - self.start_s[c]) / (1 + self.drift_ppm[c] * 1e-6)

    def save(self, path: Path | str) -> None:
        """Write as JSON artifact `headcap.time_offsets/1`."""
        save_json(path, KIND, SCHEMA, {name: list(v) if isinstance(v, tuple) else v for name, v in asdict(self).items()})

    @classmethod
    def load(cls, path: Path | str) -> "TimeOffsets":
        """Read what `save` wrote; raises `ArtifactError`."""
        content = load_json(path, KIND, SCHEMA)
        return cls(**{name: tuple(v) if isinstance(v, list) else v for name, v in content.items()})
