"""A video's pictures beside the meshes that were tracked in it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from numpy.typing import NDArray

from headcap.errors import InputError

_MISSING = object()


def paired(pictures: Iterable[NDArray], meshes: Iterable[NDArray | None]) -> Iterator[tuple[NDArray, NDArray | None]]:
    """Each picture with its mesh, one by one; raises `InputError` where one of the two ends before the other, or at once."""
    pictures, frames = iter(pictures), 0
    for mesh in meshes:
        picture = next(pictures, _MISSING)
        if picture is _MISSING:
            raise _uneven(f"fewer pictures than meshes: {frames}")
        yield picture, mesh
        frames += 1
    if next(pictures, _MISSING) is not _MISSING or frames == 0:
        raise _uneven(f"more pictures than meshes: {frames}" if frames else "a video without tracked frames")


def _uneven(found: str) -> InputError:
    return InputError(found, expected="one mesh per picture", remedy="Give the video that was tracked, whole.")
