"""Cameras that moved between calibration and a take, found from the take's own first images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from headcap.calibration.settings import BumpSettings
from headcap.cameras import Camera, Rig
from headcap.errors import InputError
from headcap.geometry.transforms import invert, rigid

Array = NDArray[np.float64]
Image = NDArray[np.uint8]


@dataclass(frozen=True)
class CameraCheck:
    """How well one camera's image agrees with its neighbours'."""

    camera: str
    residual_px: float | None
    """Median over neighbours of the median epipolar (Sampson) distance; None with too few matches to tell."""
    matches: int
    bumped: bool
    exchanged_with: str | None = None
    """Camera whose image fits here, if exchanging the two explains the residual."""


@dataclass(frozen=True)
class BumpReport:
    """Checks of all cameras of a take."""

    cameras: tuple[CameraCheck, ...]
    limit_px: float

    @property
    def bumped(self) -> tuple[str, ...]:
        """Names of cameras that disagree with the calibration."""
        return tuple(check.camera for check in self.cameras if check.bumped)

    def figures(self) -> dict[str, float]:
        """Largest residual over cameras by its name in metrics.json."""
        known = [check.residual_px for check in self.cameras if check.residual_px is not None]
        return {"calibrate.bump_residual_px": max(known)} if known else {}

    def require_unmoved(self, take: str) -> None:
        """Raise `InputError` that names every bumped camera or exchanged file."""
        lines = [self._line(check) for check in self.cameras if check.bumped]
        if lines:
            raise InputError(
                f"take {take}: {'; '.join(lines)}",
                expected=f"agreement with the calibration within {self.limit_px:g} px",
                remedy="Exchange the files back, leave the camera out of the take, or calibrate again after the bump.",
            )

    def _line(self, check: CameraCheck) -> str:
        if check.exchanged_with:
            return f"{check.camera} shows the view of {check.exchanged_with} (files exchanged)"
        off = (
            "does not match its neighbours" if check.residual_px is None else f"is {check.residual_px:.1f} px off its neighbours"
        )
        return f"{check.camera} {off} (moved since calibration)"


@dataclass(frozen=True)
class _Features:
    xy: Array
    """(n, 2) ideal image plane."""
    pixels: Array
    descriptors: NDArray[np.float32]


@dataclass(frozen=True)
class _Pair:
    first: int
    second: int
    rows: NDArray[np.int64]
    """(n, 2) matched features that agree on some epipolar geometry."""
    residual_px: float


def find_bumped(rig: Rig, images: Sequence[Image], settings: BumpSettings) -> BumpReport:
    """Match one moment's images (BGR or grey, in the rig's order) between neighbours and hold them to the calibration.

    SIFT matches are cleaned by an epipolar geometry of their own (so a wrong calibration does not clean away its witnesses)
    and then measured against the calibrated one. The camera whose pairs disagree most is taken out first and the others are
    judged without it, so a moved camera does not blame its neighbours. The subject must be still. Two cameras that agree
    after their images are exchanged are named so.
    """
    features = [_features(camera, image, settings) for camera, image in zip(rig, images, strict=True)]
    pairs = _match_pairs(rig, features, settings)
    blamed = _blame(len(rig), pairs, settings)
    exchanged = _exchanges(rig, features, pairs, blamed, settings)
    checks = []
    for number, camera in enumerate(rig):
        own = [p for p in pairs if number in (p.first, p.second) and _other(p, number) not in blamed]
        residual = float(np.median([p.residual_px for p in own])) if own else None
        other = exchanged.get(number)
        checks.append(
            CameraCheck(
                camera=camera.name,
                residual_px=residual,
                matches=int(sum(len(p.rows) for p in own)),
                bumped=number in blamed or other is not None,
                exchanged_with=None if other is None else rig[other].name,
            )
        )
    return BumpReport(tuple(checks), settings.limit_px)


def _other(pair: _Pair, camera: int) -> int:
    return pair.second if pair.first == camera else pair.first


def _features(camera: Camera, image: Image, settings: BumpSettings) -> _Features:
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    # skin is smooth: its pores and folds pass at a third of the usual contrast
    sift = cv2.SIFT_create(nfeatures=settings.features, contrastThreshold=0.013)
    points, descriptors = sift.detectAndCompute(grey, None)
    if not points:
        return _Features(np.empty((0, 2)), np.empty((0, 2)), np.empty((0, 128), np.float32))
    # at equal length and of absolute roots, descriptors compare better (RootSIFT)
    descriptors = np.sqrt(descriptors / (np.abs(descriptors).sum(1, keepdims=True) + 1e-9))
    # OpenCV's SIFT doubles the image first; its points lie right for integer pixel centres since 4.5
    pixels = np.array([point.pt for point in points])
    return _Features(camera.undistort_pixels(pixels), pixels, descriptors)


def _neighbours(rig: Rig, settings: BumpSettings) -> list[tuple[int, int]]:
    axes = np.array([camera.axis for camera in rig])
    angle = np.degrees(np.arccos(np.clip(axes @ axes.T, -1, 1)))
    np.fill_diagonal(angle, np.inf)
    chosen = set()
    for a in range(len(rig)):
        for b in np.argsort(angle[a], kind="stable")[: settings.neighbours]:
            if angle[a, b] <= settings.max_angle_deg:
                chosen.add((min(a, int(b)), max(a, int(b))))
    return sorted(chosen)


def _match_pairs(rig: Rig, features: Sequence[_Features], settings: BumpSettings) -> list[_Pair]:
    pairs = []
    for a, b in _neighbours(rig, settings):
        pair = _match(rig, a, b, features[a], features[b], settings)
        if pair is not None:
            pairs.append(pair)
    return pairs


def _match(rig: Rig, a: int, b: int, left: _Features, right: _Features, settings: BumpSettings) -> _Pair | None:
    rows = _mutual_matches(left.descriptors, right.descriptors, settings.ratio)
    if len(rows) < settings.min_matches:
        return None
    focal = 0.25 * sum(rig[i].matrix[0, 0] + rig[i].matrix[1, 1] for i in (a, b))
    x, y = left.xy[rows[:, 0]], right.xy[rows[:, 1]]
    cv2.setRNGSeed(0)
    _, inside = cv2.findFundamentalMat(x * focal, y * focal, cv2.USAC_MAGSAC, 1.0, 0.999, 5000)
    if inside is None:
        return None
    keep = np.ravel(inside).astype(bool)
    # a third of the matches agreeing by chance on eight free numbers is no evidence
    if keep.sum() < max(settings.min_matches, 0.3 * len(rows)):
        return None
    distance = focal * sampson_distance(rig[a], rig[b], x[keep], y[keep])
    return _Pair(a, b, rows[keep], float(np.median(distance)))


def _mutual_matches(left: NDArray[np.float32], right: NDArray[np.float32], ratio: float) -> NDArray[np.int64]:
    """(n, 2) rows that are each other's nearest, and clearly nearer than the second."""
    if min(len(left), len(right)) < 2:
        return np.empty((0, 2), np.int64)
    similarity = left @ right.T
    best = similarity.argmax(1)
    two = -np.partition(-similarity, 1, axis=1)[:, :2]
    # RootSIFT descriptors have unit length: distance^2 = 2 - 2 * similarity
    distance = np.sqrt(np.maximum(2 - 2 * two, 1e-12))
    mutual = similarity.argmax(0)[best] == np.arange(len(left))
    rows = np.flatnonzero(mutual & (distance[:, 0] < ratio * distance[:, 1]))
    return np.stack([rows, best[rows]], axis=1)


def sampson_distance(first: Camera, second: Camera, x: Array, y: Array) -> Array:
    """(n,) first-order distance to the epipolar constraint of ideal points x, y (n, 2), in units of the image plane."""
    second_from_first = second.camera_from_world @ invert(first.camera_from_world)
    tx, ty, tz = second_from_first[:3, 3]
    essential = np.array([[0, -tz, ty], [tz, 0, -tx], [-ty, tx, 0]]) @ second_from_first[:3, :3]
    x, y = np.column_stack([x, np.ones(len(x))]), np.column_stack([y, np.ones(len(y))])
    line_second, line_first = x @ essential.T, y @ essential
    error = np.abs((y * line_second).sum(1))
    return error / np.sqrt((line_second[:, :2] ** 2).sum(1) + (line_first[:, :2] ** 2).sum(1))


def _blame(count: int, pairs: Sequence[_Pair], settings: BumpSettings) -> list[int]:
    """Cameras to leave out, worst first, until every other agrees with most of its neighbours.

    Blurred or noisy pictures raise all residuals alike: the limit rises with the best quarter.
    """
    blamed: list[int] = []
    limit_px = max(settings.limit_px, settings.over_others * float(np.percentile([p.residual_px for p in pairs] or [0.0], 25)))
    while True:
        scores = np.zeros(count)
        for camera in range(count):
            own = [
                p.residual_px for p in pairs if camera in (p.first, p.second) and p.first not in blamed and p.second not in blamed
            ]
            # one neighbour alone cannot tell which of the two moved, unless both others of it are gone
            if camera not in blamed and len(own) >= 2:
                scores[camera] = np.median(own)
        worst = int(np.argmax(scores))
        if scores[worst] <= limit_px or len(blamed) >= count // 2:
            return blamed
        blamed.append(worst)


def _exchanges(
    rig: Rig, features: Sequence[_Features], pairs: Sequence[_Pair], blamed: Sequence[int], settings: BumpSettings
) -> dict[int, int]:
    """Among cameras that disagree or match nothing: whose image fits whose place."""
    matched = {p.first for p in pairs} | {p.second for p in pairs}
    suspects = [c for c in range(len(rig)) if c in blamed or c not in matched]
    found: dict[int, int] = {}
    for i, a in enumerate(suspects):
        for b in suspects[i + 1 :]:
            if a in found or b in found:
                continue
            exchanged = list(features)
            exchanged[a] = _relensed(features[b], rig[a])
            exchanged[b] = _relensed(features[a], rig[b])
            if all(_fits(rig, exchanged, c, [*blamed, *suspects], settings) for c in (a, b)):
                found[a], found[b] = b, a
    return found


def _relensed(features: _Features, camera: Camera) -> _Features:
    return replace(features, xy=camera.undistort_pixels(features.pixels) if len(features.pixels) else features.xy)


def _fits(rig: Rig, features: Sequence[_Features], camera: int, suspects: Sequence[int], settings: BumpSettings) -> bool:
    residuals = []
    for a, b in _neighbours(rig, settings):
        other = b if a == camera else a
        if camera in (a, b) and other not in suspects:
            pair = _match(rig, a, b, features[a], features[b], settings)
            if pair is not None:
                residuals.append(pair.residual_px)
    return bool(residuals) and float(np.median(residuals)) <= settings.limit_px


def resect(rig: Rig, images: Sequence[Image], bumped: Sequence[str], settings: BumpSettings) -> Rig:
    """The rig with the poses of `bumped` cameras solved anew from what the others see of the still subject.

    Points are triangulated by pairs of unmoved cameras; the lens is kept. Raises `InputError` with too few points: then only
    a new calibration helps.
    """
    features = [_features(camera, image, settings) for camera, image in zip(rig, images, strict=True)]
    pairs = _match_pairs(rig, features, settings)
    moved = {rig.names.index(name) for name in bumped}
    cameras = list(rig)
    for camera in sorted(moved):
        points, pixels = _points_seen_by(rig, features, pairs, camera, moved, settings)
        cameras[camera] = _resected(rig[camera], points, pixels)
    return Rig(tuple(cameras))


def _points_seen_by(
    rig: Rig,
    features: Sequence[_Features],
    pairs: Sequence[_Pair],
    camera: int,
    moved: set[int],
    settings: BumpSettings,
) -> tuple[Array, Array]:
    links = {p.first: {} for p in pairs} | {p.second: {} for p in pairs}
    for p in pairs:
        links[p.first].setdefault(p.second, []).append(p.rows)
        links[p.second].setdefault(p.first, []).append(p.rows[:, ::-1])
    points, pixels = [], []
    for near, rows in links.get(camera, {}).items():
        if near in moved:
            continue
        mine = {int(b): int(a) for a, b in np.concatenate(rows)}
        for far, others in links[near].items():
            if far == camera or far in moved:
                continue
            both = np.array([(mine[int(a)], a, b) for a, b in np.concatenate(others) if int(a) in mine]).reshape(-1, 3)
            x, y = features[near].xy[both[:, 1]], features[far].xy[both[:, 2]]
            focal = rig[near].matrix[0, 0]
            good = focal * sampson_distance(rig[near], rig[far], x, y) < settings.limit_px if len(both) else np.empty(0, bool)
            points.append(_triangulate(rig[near], rig[far], x[good], y[good]))
            pixels.append(features[camera].pixels[both[good, 0]])
    return np.concatenate(points or [np.empty((0, 3))]), np.concatenate(pixels or [np.empty((0, 2))])


def _triangulate(first: Camera, second: Camera, x: Array, y: Array) -> Array:
    if not len(x):
        return np.empty((0, 3))
    homogeneous = cv2.triangulatePoints(first.camera_from_world[:3], second.camera_from_world[:3], x.T, y.T)
    return (homogeneous[:3] / homogeneous[3]).T


def _resected(camera: Camera, points: Array, pixels: Array) -> Camera:
    remedy = "Calibrate again."
    if len(points) < 12:
        raise InputError(f"{camera.name}: {len(points)} points to place it by", expected="at least 12", remedy=remedy)
    cv2.setRNGSeed(0)
    found, rotation, translation, inside = cv2.solvePnPRansac(
        points, pixels, camera.matrix, camera.distortion, reprojectionError=3.0, iterationsCount=2000, flags=cv2.SOLVEPNP_SQPNP
    )
    if not found or inside is None or len(inside) < 12:
        raise InputError(f"{camera.name}: its image fits no pose", expected="a moved camera", remedy=remedy)
    chosen = np.ravel(inside)
    rotation, translation = cv2.solvePnPRefineLM(
        points[chosen], pixels[chosen], camera.matrix, camera.distortion, rotation, translation
    )
    return camera.moved(rigid(cv2.Rodrigues(rotation)[0], np.ravel(translation)))
