"""One person's corrected lips as pictures: error maps, shapes side by side, gap and roll over time, and a video."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from headcap.evaluation.lip_errors import BASE, CONTOUR
from headcap.evaluation.lips_person import JudgedTake
from headcap.lips.correction import canonical_meshes, canonical_truth
from headcap.lips.people import LipPerson, LipPersonTake, LipTakeFiles
from headcap.lips.takes import MouthSpace
from headcap.report.figures import Image
from headcap.report.lips_figures import gap_curves, roll_curves
from headcap.report.lips_pictures import comparison, error_maps, telling_frames, write_clip_side_by_side
from headcap.report.overlays import save_png

_MOMENTS = 4


def draw_person(
    space: MouthSpace,
    person: LipPerson,
    judged: Mapping[str, JudgedTake],
    method: str,
    maps: Path,
    shapes: Path,
    curves: Path,
) -> None:
    """Write figures 15 (`maps`) and 14 (`shapes`) and curves over time of a person's first tested take, as PNG."""
    name, take = next(iter(judged.items()))
    shown = [each for each in (BASE, CONTOUR, method) if each in take.errors.methods]
    save_png(maps, error_maps(take.errors, person.neutral, space.model.triangles, take.errors.methods[:5]))
    moments = telling_frames(take.errors, _MOMENTS)
    save_png(shapes, _shapes(space, person.takes[name], take, [*shown, "truth"], moments))
    both = [draw(take.errors, shown) for draw in (gap_curves, roll_curves)]
    save_png(curves, np.concatenate(both))


def write_comparison_video(space: MouthSpace, files: LipTakeFiles, take: JudgedTake, method: str, path: Path) -> None:
    """Write the picture with the base over it, the corrected and the true mesh, side by side, as mp4."""
    sequences = {name: take.sequences[name] for name in (BASE, method, "truth")}
    write_clip_side_by_side(path, files.clip.open(), space.model.triangles, sequences, space.mouth.vertices)


def _shapes(space: MouthSpace, performed: LipPersonTake, take: JudgedTake, names: list[str], moments: np.ndarray) -> Image:
    """Drawn as they are compared: the truth at the base's size, neutral heads laid on each other."""
    steady, base = space.mouth.steady, performed.seen.neutral
    anchor, scale = canonical_truth(performed.neutral, base, steady)
    given = {name: (scale, anchor) if name == "truth" else (1.0, base) for name in names}
    rows = []
    for frame in moments:
        placed = {
            name: canonical_meshes(size * take.sequences[name][frame][None], neutral, steady).meshes[0]
            for name, (size, neutral) in given.items()
        }
        rows.append((f"{take.errors.time_s[frame]:.2f} s", placed))
    return comparison(rows, space.model.triangles, space.mouth.vertices)
