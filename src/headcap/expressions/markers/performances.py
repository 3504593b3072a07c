"""A performance out of markers: on the markers themselves (footnote 3), or on the neutral mesh (section 5.2)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.errors import InputError
from headcap.expressions.basis import ExpressionBasis
from headcap.expressions.head_motion import moved_frames
from headcap.expressions.markers.gaps import fill_gaps
from headcap.expressions.markers.head import head_motion, rigid_markers
from headcap.expressions.markers.interpolation import interpolation_matrix
from headcap.expressions.markers.settings import MarkerSettings
from headcap.expressions.markers.swaps import refuse_swaps
from headcap.expressions.markers.take import MarkerTake
from headcap.expressions.markers.tying import tie_markers
from headcap.expressions.neutral_face import NeutralFace
from headcap.expressions.performance import BLOCK, Performance, in_memory
from headcap.expressions.performance_files import face_weights, fade_beyond


@dataclass(frozen=True, eq=False)
class StillMarkers:
    """k face markers without gaps and without the head's motion."""

    names: tuple[str, ...]
    neutral: NDArray[np.float64]
    """(k, 3) metres, in the capture frame at the neutral frame."""
    displacements: NDArray[np.float64]
    """(f, k, 3) metres."""
    figures: dict[str, float]


def marker_performance(
    take: MarkerTake,
    *,
    rigid: Sequence[str] | None = None,
    leave_out: Sequence[str] = (),
    neutral_frame: int | None = None,
    settings: MarkerSettings | None = None,
) -> Performance:
    """Displacements of the markers themselves from the neutral frame, head motion removed (footnote 3).

    `rigid` names the markers that tell the head's motion and have no part in the face; without it they are found by constant
    distances, and stay among the points. `leave_out` names markers that are not to be used. `neutral_frame` is v^0, the first
    one that shows all markers unless given. Raises `InputError` for swapped labels, gaps longer than
    `settings.longest_gap_s`, and heads whose motion cannot be told.
    """
    still = still_markers(take, rigid, leave_out, neutral_frame, settings or MarkerSettings())
    return Performance(
        neutral=still.neutral,
        triangles=np.zeros((0, 3), np.int32),
        blocks=in_memory(still.displacements),
        time_s=take.time_s,
        source=_told(take, still),
        points=still.names,
        figures=still.figures,
    )


def mesh_performance(
    take: MarkerTake,
    vertices: NDArray,
    triangles: NDArray,
    *,
    given: Mapping[str, int] | Path | None = None,
    regions: dict[str, NDArray[np.bool_]] | None = None,
    region: str | NDArray[np.bool_] | None = None,
    rigid: Sequence[str] | None = None,
    leave_out: Sequence[str] = (),
    neutral_frame: int | None = None,
    settings: MarkerSettings | None = None,
) -> Performance:
    """Displacements of every vertex of the neutral mesh (n, 3), (m, 3), metres, interpolated from the markers' (section 5.2).

    `given`: vertices by marker name, or a JSON file of them (`tying.tie_markers`); `regions` of the mesh by name; `region`, name
    or mask (n,), is where the face is, the face among `regions` unless given; beyond it, or, with neither, beyond
    `settings.reach_mm` from any marker, displacements fade to none. Other arguments are `marker_performance`'s. One matrix
    (n, k) is computed once; `blocks` multiplies it with the markers block by block. Raises `InputError` as `marker_performance`
    does, and for markers that cannot be tied.
    """
    settings = settings or MarkerSettings()
    vertices = np.asarray(vertices, float)
    still = still_markers(take, rigid, leave_out, neutral_frame, settings)
    face = NeutralFace(vertices, np.asarray(triangles, np.int32), dict(regions or {}), "the neutral mesh")
    weights = face_weights(face, region, settings.fade_mm)
    skin = None if weights is None else weights >= 1
    ties = tie_markers(still.names, still.neutral, vertices, face.triangles, settings, given=given, region=skin)
    matrix = interpolation_matrix(vertices, face.triangles, ties.marker_from_vertex)
    if weights is None:
        weights = _near_markers(face, np.unique(ties.marker_from_vertex.indices), settings)
    turned = still.displacements @ ties.mesh_from_head[:3, :3].T
    return Performance(
        neutral=vertices,
        triangles=face.triangles,
        blocks=_Interpolated((weights[:, None] * matrix).astype(np.float32), turned.astype(np.float32)),
        time_s=take.time_s,
        source=_told(take, still),
        regions=face.regions,
        figures=still.figures
        | {"tie_distance_mm": float(ties.distance_mm.mean()), "farthest_tie_mm": float(ties.distance_mm.max())},
    )


def basis_at_markers(
    basis: ExpressionBasis,
    performance: Performance,
    *,
    given: Mapping[str, int] | Path | None = None,
    settings: MarkerSettings | None = None,
) -> ExpressionBasis:
    """The shapes of a mesh where a performance's markers sit, in the markers' frame (footnote 3).

    Markers are tied to the shapes' neutral face as `tying.tie_markers` does, and raises.
    """
    ties = tie_markers(
        performance.points, performance.neutral, basis.neutral, basis.triangles, settings or MarkerSettings(), given=given
    )
    head_from_mesh = ties.mesh_from_head[:3, :3].T
    moved = np.stack([ties.marker_from_vertex @ shape @ head_from_mesh.T for shape in basis.displacements])
    return ExpressionBasis(basis.names, performance.neutral, moved, np.zeros((0, 3), np.int32))


def still_markers(
    take: MarkerTake, rigid: Sequence[str] | None, leave_out: Sequence[str], neutral_frame: int | None, settings: MarkerSettings
) -> StillMarkers:
    """Swaps refused, head motion removed, gaps filled; arguments as of `marker_performance`."""
    take = take.without(leave_out)
    refuse_swaps(take)
    rest = _neutral_frame(take, neutral_frame)
    held = rigid_markers(take, rigid, settings)
    motion, residual_mm = head_motion(take, held, rest, settings)
    upright = replace(take, positions_m=moved_frames(motion, take.positions_m))
    face = upright if rigid is None else upright.chosen(np.setdiff1d(np.arange(len(take.names)), held))
    if not face.names:
        raise InputError(
            f"all markers of {take.source} are rigid",
            expected="markers on the face",
            remedy="Name as rigid only those on the skull.",
        )
    filled, count = fill_gaps(face, settings)
    figures = {
        "rigid_markers": float(len(held)),
        "rigid_residual_mm": residual_mm,
        "filled_places": float(count),
        "filled_share": count / face.seen.size,
        "neutral_frame": float(rest),
    }
    return StillMarkers(face.names, filled[rest], filled - filled[rest], figures)


def _neutral_frame(take: MarkerTake, asked: int | None) -> int:
    whole = take.seen.all(axis=1)
    if asked is not None and not 0 <= asked < len(whole):
        raise InputError(f"neutral frame {asked}", expected=f"0 to {len(whole) - 1}", remedy="Count frames from zero.")
    if asked is None and whole.any():
        return int(whole.argmax())
    if asked is not None and whole[asked]:
        return asked
    # no gap is filled in what everything is measured from
    fullest = asked if asked is not None else int(take.seen.sum(axis=1).argmax())
    missing = ", ".join(np.array(take.names)[~take.seen[fullest]][:8])
    raise InputError(
        f"{take.source}: frame {fullest} does not show {missing}",
        expected="a neutral frame that shows every marker",
        remedy="Name another neutral frame, or leave these markers out by name.",
    )


def _told(take: MarkerTake, still: StillMarkers) -> str:
    notes = "".join(f"; {note}" for note in take.notes)
    return f"{take.source} (neutral: frame {still.figures['neutral_frame']:.0f}{notes})"


def _near_markers(face: NeutralFace, tied: NDArray, settings: MarkerSettings) -> NDArray[np.float32]:
    """(n,) one within reach of a marker along the skin, then fading."""
    marks = np.zeros(len(face.vertices), bool)
    marks[tied] = True
    within = fade_beyond(face.vertices, face.triangles, marks, settings.reach_mm) > 0
    return fade_beyond(face.vertices, face.triangles, within, settings.fade_mm)


class _Interpolated:
    """Blocks of a matrix (n, k) times displacements of markers (f, k, 3)."""

    def __init__(self, matrix: NDArray[np.float32], displacements: NDArray[np.float32]) -> None:
        self._matrix, self._displacements = matrix, displacements

    def __call__(self) -> Iterator[NDArray[np.float32]]:
        for first in range(0, len(self._displacements), BLOCK):
            block = self._displacements[first : first + BLOCK]
            columns = block.transpose(1, 0, 2).reshape(block.shape[1], -1)
            moved = (self._matrix @ columns).reshape(len(self._matrix), len(block), 3)
            yield np.ascontiguousarray(moved.transpose(1, 0, 2))
