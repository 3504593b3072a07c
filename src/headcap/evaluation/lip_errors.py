"""One take's lips against truth: the base tracker's, and those of any number of corrections (lip paper, section 6).

The two neutral faces are laid on each other once per take, at the base's size, which one camera cannot tell; then all meshes are
compared in a canonical frame, rigid motion removed by the skin above the mouth that holds still. Errors are given in the true
person's millimetres.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import load_arrays, save_arrays
from headcap.errors import InputError
from headcap.evaluation.lip_sections import LipSections
from headcap.geometry.transforms import fit_rigid, transform
from headcap.lips.correction import TrueNeutral, canonical_meshes, canonical_truth
from headcap.lips.mouth import Mouth

KIND, SCHEMA = "lip_errors", 1
BASE, CONTOUR = "base", "contour"


@dataclass(frozen=True, eq=False)
class LipErrors:
    """Errors of one take: m methods, f frames, k vertices of the mouth's mask (figure 7). NaN in frames without an answer."""

    person: str
    take: str
    methods: tuple[str, ...]
    """`BASE` first. Others: `CONTOUR`; PS, MS or GR (section 6), and one of these with a word of what was changed: affine, shape,
    distances, reprojected."""
    time_s: NDArray[np.float64]
    """(f,)"""
    truth_known: NDArray[np.bool_]
    """(f,) frames that have a truth."""
    vertices: NDArray[np.int64]
    """(k,)"""
    error_mm: NDArray[np.float64]
    """(m, f) mean over the vertices of their distance to the truth."""
    square_mm2: NDArray[np.float64]
    """(m, f) mean over the vertices of its square."""
    shape_error_mm: NDArray[np.float64]
    """(m, f) as `error_mm` after one more rigid alignment, of the mask's own vertices: what is wrong with its shape. Where
    the base tracker has the mouth, corrections of gradients leave alone (section 4.2)."""
    vertex_error_mm: NDArray[np.float64]
    """(m, k) mean distance over the frames that a method answered; NaN where it answered none."""
    gap_mm: NDArray[np.float64]
    """(m + 1, f) distance between the lips, mean over `LipSections`; the last row is the truth's."""
    roll_deg: NDArray[np.float64]
    """(m + 1, f, 2) how far upper and lower lip are rolled out; the last row is the truth's."""
    roll_error_deg: NDArray[np.float64]
    """(m, f) mean over sections and lips of the angle between a method's roll and the truth's."""
    layer_error: NDArray[np.float64]
    """(m, f) rms error of all triangles' nine numbers (radians and strains) as a method regressed them; NaN where it did not."""
    scale: float
    """Size of the base's neutral head over the true one's, which the comparison takes off."""

    @property
    def answered(self) -> NDArray[np.bool_]:
        """(m, f) frames with truth that a method answered."""
        return np.isfinite(self.error_mm) & self.truth_known

    @property
    def common(self) -> NDArray[np.bool_]:
        """(f,) frames that all methods answered which answered any: what makes their means comparable."""
        answered = self.answered
        return answered[answered.any(axis=1)].all(axis=0) & answered[0]

    def row(self, method: str) -> int:
        """Place of a method."""
        return self.methods.index(method)

    def unanswered(self, method: str) -> int:
        """Frames with truth that a method gave no answer to."""
        return int((self.truth_known & ~self.answered[self.row(method)]).sum())

    def save(self, path: Path | str) -> None:
        """Write as npz artifact `headcap.lip_errors/1`."""
        meta = {"person": self.person, "take": self.take, "methods": list(self.methods), "scale": self.scale}
        save_arrays(path, KIND, SCHEMA, {name: getattr(self, name) for name in _ARRAYS}, meta)

    @classmethod
    def load(cls, path: Path | str) -> LipErrors:
        """Read what `save` wrote; raises `ArtifactError`."""
        arrays, meta = load_arrays(path, KIND, SCHEMA)
        return cls(methods=tuple(meta.pop("methods")), **meta, **arrays)


_ARRAYS = (
    "time_s",
    "truth_known",
    "vertices",
    "error_mm",
    "square_mm2",
    "shape_error_mm",
    "vertex_error_mm",
    "gap_mm",
    "roll_deg",
    "roll_error_deg",
    "layer_error",
)


@dataclass(frozen=True, eq=False)
class LipReference:
    """What one person's sequences are compared by, all in one topology of n vertices."""

    mouth: Mouth
    sections: LipSections
    base_neutral: NDArray[np.float64]
    """C_0 (n, 3) metres: the base-tracked mouth at rest, canonical."""
    truth_neutral: NDArray[np.float64] | TrueNeutral
    """H_0 (n, 3) metres: the true one, in any frame."""


def compare_lips(
    reference: LipReference,
    truth: Iterable[NDArray],
    sequences: Mapping[str, Iterable[NDArray]],
    time_s: NDArray,
    *,
    person: str,
    take: str,
    layer_errors: Mapping[str, NDArray] | None = None,
    knowing: Collection[str] = (),
) -> LipErrors:
    """Errors of base-tracked and corrected meshes (n, 3) by method, frame by frame, against true ones, metres.

    `sequences` holds "base" at least; each may be an array (f, n, 3), a memory map or an iterator, in any frame: one frame of
    each is held at a time. A mesh that is not finite is a frame without an answer (or without truth). `layer_errors` (f,) are
    those of `layer_error`, by method. Methods `knowing` the person's true neutral head have it in the
    base's place and are aligned by it. Truth of another topology is carried over first (`face_correspondence`). Raises
    `InputError` without a base, for another topology or numbers of frames that differ.
    """
    if BASE not in sequences:
        raise _refused(f"sequences {', '.join(sequences) or 'none'}", f"one called {BASE}")
    names = (BASE, *(name for name in sequences if name != BASE))
    frames, regressed = len(time_s), layer_errors or {}
    scored = _Scores(reference, [name in knowing for name in names], frames)
    for frame, meshes in enumerate(_together([truth, *(sequences[name] for name in names)], frames)):
        scored.add(frame, meshes[0], meshes[1:])
    layers = [np.asarray(regressed.get(name, np.full(frames, np.nan)), np.float64) for name in names]
    if any(layer.shape != (frames,) for layer in layers):
        raise _refused(f"layer errors of {', '.join(str(len(layer)) for layer in layers)} frames", f"{frames} each")
    return LipErrors(person, take, names, np.asarray(time_s, np.float64), layer_error=np.stack(layers), **scored.arrays())


def layer_error(predicted: NDArray, true: NDArray) -> NDArray[np.float64]:
    """(f,) rms over all triangles' nine numbers of predicted (f, T, 9) less true layers (f, T, 9), NaN where either is.

    The feature space error of table 2 (the paper does not say how it is averaged within a frame).
    """
    out = np.empty(len(predicted))
    for frame, (one, other) in enumerate(zip(predicted, true, strict=True)):
        out[frame] = np.sqrt(np.mean((np.asarray(one, np.float64) - other) ** 2))
    return out


class _Scores:
    """Rows of `LipErrors`, filled frame by frame."""

    def __init__(self, reference: LipReference, knowing: Sequence[bool], frames: int) -> None:
        self.reference, self.vertices, methods = reference, reference.mouth.vertices, len(knowing)
        self.base_neutral = np.asarray(reference.base_neutral, np.float64)
        self.anchor, self.scale = canonical_truth(reference.truth_neutral, self.base_neutral, reference.mouth.steady)
        self.neutrals = [self.anchor if knows else self.base_neutral for knows in knowing]
        self.truth_known = np.zeros(frames, bool)
        self.error, self.square, self.shape, self.roll_error = (np.full((methods, frames), np.nan) for _ in range(4))
        self.gap, self.roll = np.full((methods + 1, frames), np.nan), np.full((methods + 1, frames, 2), np.nan)
        self.vertex_sums = np.zeros((methods, len(self.vertices)))

    def add(self, frame: int, truth: NDArray, meshes: tuple[NDArray, ...]) -> None:
        """One frame's true mesh and those of the methods."""
        steady, sections, unit = self.reference.mouth.steady, self.reference.sections, 1e3 / self.scale
        true = canonical_meshes(self.scale * np.asarray(truth, np.float64)[None], self.anchor, steady).meshes[0]
        roll = sections.roll(true)
        self.truth_known[frame] = bool(np.isfinite(true[self.vertices]).all())
        self.gap[-1, frame], self.roll[-1, frame] = unit * sections.gap(true).mean(), np.degrees(roll.mean(axis=1))
        for row, mesh in enumerate(meshes):
            placed = canonical_meshes(np.asarray(mesh)[None], self.neutrals[row], steady).meshes[0]
            away = unit * np.linalg.norm(placed[self.vertices] - true[self.vertices], axis=1)
            self.error[row, frame], self.square[row, frame] = away.mean(), (away**2).mean()
            own = sections.roll(placed)
            self.gap[row, frame], self.roll[row, frame] = unit * sections.gap(placed).mean(), np.degrees(own.mean(axis=1))
            # the shorter way round
            turned = np.degrees(np.abs(np.arctan2(np.sin(own - roll), np.cos(own - roll))))
            self.roll_error[row, frame] = turned.mean()
            if np.isfinite(self.error[row, frame]):
                self.vertex_sums[row] += away
                self.shape[row, frame] = unit * _shape_error(placed[self.vertices], true[self.vertices])

    def arrays(self) -> dict[str, NDArray | float]:
        """What `LipErrors` holds of it."""
        answers = np.isfinite(self.error).sum(axis=1, keepdims=True)
        with np.errstate(invalid="ignore"):
            vertex_error = self.vertex_sums / np.where(answers, answers, np.nan)
        return {
            "truth_known": self.truth_known,
            "vertices": self.vertices,
            "error_mm": self.error,
            "square_mm2": self.square,
            "shape_error_mm": self.shape,
            "vertex_error_mm": vertex_error,
            "gap_mm": self.gap,
            "roll_deg": self.roll,
            "roll_error_deg": self.roll_error,
            "scale": float(self.scale),
        }


def _shape_error(points: NDArray, true: NDArray) -> float:
    """Mean distance of points (k, 3) to true ones (k, 3), rigidly moved onto them."""
    return float(np.linalg.norm(transform(fit_rigid(points, true), points) - true, axis=1).mean())


def _together(sequences: list[Iterable[NDArray]], frames: int) -> Iterator[tuple[NDArray, ...]]:
    """Frame by frame; refuses sequences that end early or go on."""
    sources, missing = [iter(sequence) for sequence in sequences], object()
    for frame in range(frames + 1):
        row = tuple(next(source, missing) for source in sources)
        ended = sum(mesh is missing for mesh in row)
        if ended != (len(row) if frame == frames else 0):
            raise _refused(f"sequences of which {ended} of {len(row)} end at frame {frame}", f"{frames} frames each")
        if frame < frames:
            yield row


def _refused(found: str, expected: str) -> InputError:
    return InputError(found, expected=expected, remedy="Give the truth, the base track and its corrections of the same frames.")
