"""Dense flow against DIS-medium on six Middlebury pairs: end-point errors and CPU-seconds."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from run import measure, write

from headcap.registration.flow import FlowSettings, dense_flow


def run(out_path: Path) -> None:
    """Measure both on every pair and write the figures."""
    cv2.setNumThreads(1)
    pairs = {folder.name: _pair(folder) for folder in sorted(_data().iterdir()) if folder.is_dir()}
    peer_flow = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    errors = {
        name: {
            "ours_px": _error(dense_flow(first, second, FlowSettings()).displacement, truth),
            "dis_medium_px": _error(peer_flow.calc(first, second, None), truth),
        }
        for name, (first, second, truth) in pairs.items()
    }
    ours = measure(lambda: [dense_flow(first, second, FlowSettings()) for first, second, _ in pairs.values()])
    peer = measure(lambda: [peer_flow.calc(first, second, None) for first, second, _ in pairs.values()])
    mean = {name: float(np.mean([pair[name] for pair in errors.values()])) for name in ("ours_px", "dis_medium_px")}
    write(
        out_path,
        ours=ours | {"name": "normalised DIS + variational refinement", "error_px": mean["ours_px"]},
        peer=peer | {"name": "OpenCV DIS medium", "error_px": mean["dis_medium_px"]},
        figures={"end_point_error": errors},
    )


def _data() -> Path:
    named = os.environ.get("HEADCAP_TEST_DATA")
    return (Path(named) if named else Path(__file__).resolve().parents[3] / "shared" / "data") / "flow"


def _pair(folder: Path):
    first, second = (cv2.imread(str(folder / f"frame{n}.png"), cv2.IMREAD_GRAYSCALE) for n in (10, 11))
    with open(folder / "flow10.flo", "rb") as handle:
        handle.read(4)
        width, height = np.fromfile(handle, np.int32, 2)
        return first, second, np.fromfile(handle, np.float32).reshape(height, width, 2)


def _error(found: np.ndarray, truth: np.ndarray) -> float:
    known = (np.abs(truth) < 1e9).all(2)
    return float(np.linalg.norm(found - truth, axis=2)[known].mean())
