"""Eigenfaces of a performance, streamed over its frames (quasi-eigen paper, eq. 2)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from headcap.errors import InputError
from headcap.expressions.basis import Eigenfaces
from headcap.expressions.performance import Performance
from headcap.geometry.leading_directions import Directions, covering, covering_directions, exact_directions, leading_directions

EXACT = 512
"""Frames or columns up to which the decomposition is exact."""
MOST = 512
"""Eigenfaces of a long performance that a coverage may ask for: what needs more is noise."""
_GATHERED = 256
"""Frames that are multiplied at once."""
_NAMED = 10
"""Frames that a message names."""


def eigenfaces(performance: Performance, *, coverage: float = 0.995, count: int | None = None, seed: int = 0) -> Eigenfaces:
    """Principal axes of a performance about its mean displacement: eq. 2 with the coverage defined below it.

    The fewest axes that cover `coverage` of the variance, or `count` of them; fewer only where the frames hold no more than
    single precision tells from rounding (a ten thousandth of the largest deviation). Up to 512 frames, or columns as markers have
    them, are decomposed exactly; longer performances by randomised subspace iteration with Rayleigh-Ritz until a pass gains less
    than a thousandth of what is left (`geometry.leading_directions`), in memory that grows with the axes and not with the frames.
    Each axis points the way that the mean displacement does. Raises `InputError` for frames that are not finite, by number; for
    as many axes as there are frames, or more; for a performance that does not move; for a coverage that 512 axes do not reach.
    """
    if not 0 < coverage <= 1:
        raise ValueError(f"coverage {coverage} is not in (0, 1]")
    _require_frames(performance, count)
    mean = mean_displacement(performance)
    found = _directions(performance, mean, coverage, count, seed).told()
    if not len(found.values):
        raise InputError(
            f"{performance.source} does not move", expected="frames that differ", remedy="Give a performance with expressions."
        )
    kept = covering(found, coverage) if count is None else count
    if count is None and kept > len(found.values):
        raise _uncovered(performance, found, coverage)
    return _oriented(found.first(kept), mean, performance)


def mean_displacement(performance: Performance) -> NDArray[np.float64]:
    """mu of section 4 as (3 n,), metres; raises `InputError` naming frames that are not finite."""
    total, first, broken = np.zeros(performance.columns), 0, []
    for rows in performance.rows():
        if rows.shape[1] != performance.columns:
            raise InputError(
                f"{performance.source}, frame {first}: {rows.shape[1] // 3} points",
                expected=f"{performance.columns // 3} as the neutral face has",
                remedy="Give frames and neutral face of one topology.",
            )
        part = rows.sum(axis=0, dtype=np.float64)
        if np.isfinite(part).all():
            total += part
        else:
            broken.extend(first + np.flatnonzero(~np.isfinite(rows).all(axis=1)))
        first += len(rows)
    if broken:
        raise _not_finite(performance, broken)
    return total / first


def about_mean(performance: Performance, mean: NDArray) -> Iterator[NDArray[np.float32]]:
    """Frames as rows (f, 3 n) about their mean, in blocks that are worth a product whatever those of the performance are."""
    about, gathered = mean.astype(np.float32), []
    for rows in performance.rows():
        gathered.append(rows)
        if sum(map(len, gathered)) >= _GATHERED:
            yield np.concatenate(gathered) - about
            gathered = []
    if gathered:
        yield np.concatenate(gathered) - about


def _directions(performance: Performance, mean: NDArray, coverage: float, count: int | None, seed: int) -> Directions:
    def blocks() -> Iterator[NDArray[np.float32]]:
        return about_mean(performance, mean)

    columns, frames = performance.columns, len(performance)
    if min(columns, frames) <= EXACT:
        return exact_directions(blocks, columns)
    if count is None:
        return covering_directions(blocks, columns, coverage, most=min(MOST, frames - 1), seed=seed)
    return leading_directions(blocks, columns, count, seed=seed)


def _oriented(found: Directions, mean: NDArray, performance: Performance) -> Eigenfaces:
    """The sign of an eigenvector means nothing: a positive weight here moves the face the way it moves on average."""
    along = found.vectors @ mean
    # where the mean says nothing, the coordinate that moves most is positive
    largest = np.take_along_axis(found.vectors, np.abs(found.vectors).argmax(axis=1)[:, None], axis=1)[:, 0]
    sign = np.where(np.abs(along) > 1e-3 * np.linalg.norm(mean), along, largest)
    vectors = found.vectors * np.where(sign < 0, -1.0, 1.0)[:, None]
    shape = performance.neutral.shape
    return Eigenfaces(
        mean=mean.reshape(shape).astype(np.float32),
        vectors=vectors.reshape(-1, *shape).astype(np.float32),
        variances=found.values**2 / len(performance),
        total_variance=found.energy / len(performance),
    )


def _require_frames(performance: Performance, count: int | None) -> None:
    if count is not None and count < 1:
        raise ValueError(f"{count} eigenfaces")
    # frames about their mean span one direction less than they are
    least = 2 if count is None else count + 1
    if len(performance) < least:
        raise InputError(
            f"{performance.source} has {len(performance)} frames",
            expected=f"at least {least}" + ("" if count is None else f" for {count} eigenfaces"),
            remedy="Give a longer performance, or ask for fewer eigenfaces.",
        )


def _not_finite(performance: Performance, broken: list[int]) -> InputError:
    named = ", ".join(str(frame) for frame in broken[:_NAMED])
    more = f" and {len(broken) - _NAMED} more" if len(broken) > _NAMED else ""
    return InputError(
        f"{performance.source}: coordinates that are not finite in {len(broken)} of {len(performance)} frames: {named}{more}",
        expected="finite coordinates in every frame",
        remedy="Repair or cut these frames; gaps of markers are filled when they are read.",
    )


def _uncovered(performance: Performance, found: Directions, coverage: float) -> InputError:
    reached = float(np.sum(found.values**2)) / found.energy
    return InputError(
        f"{performance.source}: {len(found.values)} eigenfaces cover {reached:.4%} of the variance",
        expected=f"{coverage:.4%}",
        remedy="Smooth the performance over time, ask for a smaller coverage, or say how many eigenfaces there should be.",
    )
