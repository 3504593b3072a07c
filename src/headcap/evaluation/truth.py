"""A truth folder: what the subject, the cameras and the clocks really did, read lazily."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.cameras import Camera, Rig
from headcap.errors import InputError
from headcap.geometry.transforms import rigid
from headcap.lips.monocular.detections import SCHEMES

_INTERPOLATION_FRAMES = 4


@dataclass(frozen=True)
class TakeTruth:
    """The true surface of one take at the frames of its reference camera, kept as 16-bit offsets from the first frame."""

    take: str
    time_s: NDArray[np.float64]
    """(t,) on the true clock."""
    first_m: NDArray[np.float32]
    """(n, 3) metres, true world."""
    offsets: NDArray[np.int16]
    """(t, n, 3) in `step_m`."""
    step_m: float

    def __len__(self) -> int:
        return len(self.time_s)

    def frame(self, number: int) -> NDArray[np.float64]:
        """True vertices (n, 3) of one frame."""
        return self.first_m + self.offsets[number] * self.step_m

    def at(self, time_s: float) -> NDArray[np.float64]:
        """True vertices (n, 3) at any moment of the take: the cubic through the four frames around it.

        Half a frame beyond either end is extrapolated; further out raises ValueError. Halfway between frames the error
        is 0.023 h^4 of the fourth derivative (h: time between frames), at a frame it is zero.
        """
        times = self.time_s
        slack = 0.5 * float(np.median(np.diff(times))) if len(times) > 1 else 0.0
        if not times[0] - slack <= time_s <= times[-1] + slack:
            raise ValueError(f"{self.take}: truth spans {times[0]:.4f} to {times[-1]:.4f} s, asked for {time_s:.4f} s")
        count = min(_INTERPOLATION_FRAMES, len(times))
        begin = int(np.clip(np.searchsorted(times, time_s) - count // 2, 0, len(times) - count))
        nodes = times[begin : begin + count]
        weights = [np.prod([(time_s - b) / (a - b) for b in nodes if b != a]) for a in nodes]
        return self.first_m + self.step_m * np.tensordot(weights, self.offsets[begin : begin + count].astype(float), axes=1)


@dataclass(frozen=True)
class ScanPlacement:
    """How the scan was placed: scan = scale * R @ world + t, in the scan's own unit."""

    rotation: NDArray[np.float64]
    translation: NDArray[np.float64]
    scale: float

    def world_from_scan(self, points: NDArray) -> NDArray[np.float64]:
        """Scan coordinates (n, 3) to metres in the true world."""
        return ((points - self.translation) / self.scale) @ self.rotation


@dataclass(frozen=True)
class Truth:
    """One truth folder: rig.json, topology.npz, scan.json and one npz per take."""

    folder: Path

    def __post_init__(self) -> None:
        if not (self.folder / "rig.json").is_file():
            raise InputError(
                f"{self.folder} holds no rig.json",
                expected="a truth folder (rig.json, topology.npz, scan.json, <take>.npz)",
                remedy="Give the folder a rehearsal wrote, or leave `truth` out of the session file.",
            )

    @cached_property
    def _rig_document(self) -> dict:
        return json.loads((self.folder / "rig.json").read_text())

    @cached_property
    def rig(self) -> Rig:
        """The true cameras in the true world; named cam00, cam01, ... where the folder names none."""
        document = self._rig_document
        return Rig(tuple(_camera(entry, index, document) for index, entry in enumerate(document["cameras"])))

    @property
    def takes(self) -> tuple[str, ...]:
        """Takes of which the true surface is known."""
        return tuple(take for take in self._rig_document["takes"] if (self.folder / f"{take}.npz").is_file())

    def start_s(self, take: str) -> dict[str, float]:
        """True time of the first frame of each camera's recording."""
        return dict(zip(self.rig.names, self._rig_document["takes"][take]["first_frame_time_s"], strict=True))

    def drift_ppm(self, take: str) -> dict[str, float]:
        """True clock drift of each camera; zero where the folder states none."""
        stated = self._rig_document["takes"][take].get("drift_ppm", [0.0] * len(self.rig))
        return dict(zip(self.rig.names, stated, strict=True))

    def take(self, take: str) -> TakeTruth:
        """The true surface of one take; the two used last are kept in memory."""
        return _load_take(self.folder / f"{take}.npz", take)

    def larynx_height(self, take: str) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """Times (t,) on the true clock and the larynx's height (t,) over its rest, metres; None where the take tells none."""
        with np.load(self.folder / f"{take}.npz") as arrays:
            if "larynx_dy_m" not in arrays:
                return None
            return arrays["time_s"].astype(float), arrays["larynx_dy_m"].astype(float)

    @cached_property
    def _topology(self) -> dict[str, NDArray]:
        with np.load(self.folder / "topology.npz", allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}

    @property
    def triangles(self) -> NDArray[np.int32]:
        """(m, 3) of the true surface."""
        return self._topology["faces"]

    @property
    def landmark_points(self) -> NDArray[np.int64]:
        """(k,) vertices of all landmarks, in the folder's order; without names the 68 of the iBUG scheme."""
        return self._topology["landmarks68"]

    @property
    def landmarks(self) -> dict[str, int]:
        """Named vertices of the true surface: by the folder's own names, else those of the iBUG scheme's 68."""
        points = self.landmark_points.tolist()
        if "landmark_names" in self._topology:
            return dict(zip(self._topology["landmark_names"].tolist(), points, strict=True))
        return {name: points[at] for name, at in SCHEMES[len(points)].items()}

    @property
    def inner_lip_middle(self) -> tuple[int, int]:
        """The middle vertices of the upper and the lower inner lip; their distance is the lip gap."""
        upper, lower = self._topology["inner_lip_upper"], self._topology["inner_lip_lower"]
        return int(upper[len(upper) // 2]), int(lower[len(lower) // 2])

    @cached_property
    def scan(self) -> ScanPlacement:
        """Where the scan lies."""
        placed = json.loads((self.folder / "scan.json").read_text())["scan_from_world"]
        return ScanPlacement(np.array(placed["R"], float), np.array(placed["t"], float), float(placed["scale"]))


def _camera(entry: dict, index: int, document: dict) -> Camera:
    return Camera(
        name=entry.get("name", f"cam{index:02d}"),
        width=int(entry.get("width", document.get("width"))),
        height=int(entry.get("height", document.get("height"))),
        matrix=np.array(entry["K"], float),
        distortion=np.array(entry["dist"], float).ravel(),
        camera_from_world=rigid(np.array(entry["R"], float), np.array(entry["t"], float).ravel()),
    )


@lru_cache(maxsize=2)
def _load_take(path: Path, take: str) -> TakeTruth:
    with np.load(path, allow_pickle=False) as archive:
        stated = re.search(r"\*\s*([0-9.eE+-]+)\s*m", str(archive["unit"])) if "unit" in archive.files else None
        return TakeTruth(
            take=take,
            time_s=archive["time_s"].astype(np.float64),
            first_m=archive["first_m"],
            offsets=archive["vertices_mm_i16"],
            step_m=float(stated.group(1)) if stated else 4e-6,
        )
