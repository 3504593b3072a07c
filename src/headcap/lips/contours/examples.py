"""A study's contour detector, from what tracked meshes show of lips (lip paper, section 3.2.2).

The paper labels contours by hand; a rig's meshes know where the lips' border lies and, for each camera, where lips end.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import zip_longest

import numpy as np
from numpy.typing import NDArray

from headcap.cameras import Camera
from headcap.lips.contours.training import LipExample
from headcap.lips.contours.window import MouthLocator
from headcap.lips.mesh_contours import MeshContours


def labelled_pictures(
    pictures: Iterable[NDArray[np.uint8]],
    base: Iterable[NDArray],
    truth: Iterable[NDArray],
    camera: Camera,
    locator: MouthLocator,
    contours: MeshContours,
    person: str,
    chosen: Sequence[int],
) -> Iterator[LipExample]:
    """Chosen frames of a take, labelled by true meshes (n, 3); frames whose mouth the base tracker (n, 3) lost are left out."""
    wanted = set(chosen)
    for frame, (picture, mesh, true) in enumerate(zip_longest(pictures, base, truth)):
        view = locator(np.asarray(mesh, float), camera) if frame in wanted else None
        if view is not None and np.isfinite(true).all():
            yield LipExample(picture, view, contours(np.asarray(true, float), camera), person).cropped()


def spread_frames(frames: int, count: int) -> list[int]:
    """At most `count` frames of so many, evenly spread."""
    return sorted(set(np.linspace(0, frames - 1, min(count, frames)).round().astype(int).tolist()))
