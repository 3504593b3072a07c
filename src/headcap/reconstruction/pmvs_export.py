"""A workspace that PMVS2 opens: `pmvs2 <folder>/ option-all` (the slash belongs to it: PMVS2 puts names right behind).

visualize/%08d.ppm   distortion-free photographs, numbered from 0 without gaps
masks/%08d.pgm       where there are silhouettes: above 127 on the subject
txt/%08d.txt         the word CONTOUR and the 3 x 4 projection matrix row by row; pixels count from the first one's centre
models/              where PMVS2 writes
vis.dat              the word VISDATA, the number of views, then per view its number, how many it is matched with, and which
option-all           a name and its value per line; timages -1 0 n: make points of views 0 to n - 1

`bundle.rd.out` is input of CMVS, which cuts large sets of photographs into clusters; PMVS2 itself does not read it.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from headcap.cameras import Rig
from headcap.reconstruction.settings import ReconstructSettings
from headcap.reconstruction.views import choose_sources, pinhole_views, subject_centre

OPTIONS = {"level": 0, "csize": 2, "threshold": 0.7, "wsize": 7, "minImageNum": 3, "CPU": 1, "useVisData": 1, "sequence": -1}
"""PMVS2's options (Furukawa and Ponce 2010) for a face that fills the picture."""


def export_pmvs(
    folder: Path, rig: Rig, images_bgr: list[NDArray[np.uint8]], *, settings: ReconstructSettings, masks: list | None = None
) -> None:
    """Write one frame as a PMVS workspace into `folder`, views in the rig's order; masks become silhouettes (masks/%08d.pgm)."""
    views = pinhole_views(rig, images_bgr, masks, settings)
    pinholes = Rig(tuple(view.camera for view in views))
    sources = choose_sources(pinholes, subject_centre(pinholes), settings.matching)
    for part in ("visualize", "txt", "models", *(("masks",) if masks else ())):
        (folder / part).mkdir(parents=True, exist_ok=True)
    for index, view in enumerate(views):
        cv2.imwrite(str(folder / "visualize" / f"{index:08d}.ppm"), view.colour)
        projection = view.camera.matrix @ view.camera.camera_from_world[:3]
        lines = [" ".join(repr(float(value)) for value in row) for row in projection]
        (folder / "txt" / f"{index:08d}.txt").write_text("CONTOUR\n" + "\n".join(lines) + "\n")
        if masks:
            cv2.imwrite(str(folder / "masks" / f"{index:08d}.pgm"), view.valid.astype(np.uint8) * 255)
    links = [f"{index} {len(chosen)} {' '.join(map(str, chosen))}".rstrip() for index, chosen in enumerate(sources)]
    (folder / "vis.dat").write_text("\n".join(["VISDATA", str(len(views)), *links]) + "\n")
    options = [f"{key} {value}" for key, value in OPTIONS.items()]
    options += [f"timages -1 0 {len(views)}", "oimages 0"]
    (folder / "option-all").write_text("\n".join(options) + "\n")
