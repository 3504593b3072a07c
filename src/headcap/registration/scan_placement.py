"""Where the scan lay, so that it can be shown beside the template."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import load_json, save_json
from headcap.geometry.transforms import transform
from headcap.registration.scan import Scan

KIND, SCHEMA = "scan_placement", 1


@dataclass(frozen=True)
class ScanPlacement:
    """The rigid transform from the scan's frame to the registered template's."""

    base_from_scan: NDArray[np.float64]
    """(4, 4), metres."""

    def save(self, path: Path | str) -> None:
        """Write as JSON artifact `headcap.scan_placement/1`."""
        save_json(path, KIND, SCHEMA, {"base_from_scan": np.asarray(self.base_from_scan).tolist()})

    @classmethod
    def load(cls, path: Path | str) -> ScanPlacement:
        """Read what `save` wrote; raises `ArtifactError`."""
        return cls(np.array(load_json(path, KIND, SCHEMA)["base_from_scan"]))

    def placed(self, scan: Scan) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
        """Vertices (n, 3) in the template's frame and triangles (m, 3) of the scan."""
        return transform(self.base_from_scan, scan.vertices), scan.triangles
