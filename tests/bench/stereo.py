"""Dense stereo of one still frame, 16 views of 540x960: ours against OpenCV's SGBM with a multi-view check.

Reads the recordings named by HEADCAP_TEST_DATA (or ../shared/data). Both get the true cameras and the same photographs,
on one thread; both are measured against the true surface. `HEADCAP_BENCH_LARGE=1` adds the same frame enlarged to
1080x1920, for seconds and memory alone.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import av
import cv2
import numpy as np
from scipy.spatial import cKDTree

sys.path.insert(0, str(Path(__file__).resolve().parent))
from run import measure, peak_memory_gib, write

from headcap.cameras import Camera, Rig
from headcap.meshes.rasteriser import rasterise
from headcap.reconstruction.frame import reconstruct_frame
from headcap.reconstruction.settings import ReconstructSettings
from headcap.reconstruction.views import pinhole_views, subject_centre

TAKE, STILL_S = "pose_01", 0.30
SETTINGS = ReconstructSettings(engine="patchmatch")
PAIRS = (
    (0, 1),
    (2, 3),
    (4, 5),
    (6, 7),
    (8, 9),
    (10, 11),
    (12, 13),
    (14, 15),
    (2, 4),
    (4, 6),
    (6, 8),
    (8, 10),
    (10, 12),
    (12, 14),
)
DISPARITIES = 256


def run(out_path: Path) -> None:
    """Measure both and write their figures."""
    cv2.setNumThreads(1)
    rig, images, vertices, faces = load_frame(data_folder())
    surface = seen_surface(rig, vertices, faces)
    small = [cv2.resize(image, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA) for image in images]
    shrunk = Rig(tuple(camera.scaled(0.25) for camera in rig))
    reconstruct_frame(shrunk, small, time_s=0.0, settings=SETTINGS)  # compiles
    clouds = {}
    ours = measure(lambda: clouds.update(ours=reconstruct_frame(rig, images, time_s=STILL_S, settings=SETTINGS).positions))
    memory = peak_memory_gib()
    peer = measure(lambda: clouds.update(peer=sgbm_points(rig, images)))
    for side, name in ((ours, "ours"), (peer, "peer")):
        side |= accuracy(clouds[name], vertices, faces, surface)
    figures = {"ours_peak_memory_gib": memory}
    if os.environ.get("HEADCAP_BENCH_LARGE"):
        figures |= large_frame(rig, images)
    write(out_path, ours={"name": "headcap patchmatch", **ours}, peer={"name": "OpenCV SGBM, 14 pairs", **peer}, figures=figures)


def data_folder() -> Path:
    """The folder of recordings; leaves with a message where there is none."""
    named = os.environ.get("HEADCAP_TEST_DATA")
    folder = Path(named) if named else Path(__file__).resolve().parents[3] / "shared" / "data"
    if not (folder / "ict_rig").is_dir():
        sys.exit("bench stereo needs recordings: set HEADCAP_TEST_DATA to their folder")
    return folder / "ict_rig"


def load_frame(folder: Path) -> tuple[Rig, list[np.ndarray], np.ndarray, np.ndarray]:
    """True cameras, photographs of a still moment, true vertices and triangles."""
    document = json.loads((folder / "truth" / "rig.json").read_text())
    starts = document["takes"][TAKE]["first_frame_time_s"]
    cameras, images = [], []
    for k, truth in enumerate(document["cameras"]):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = truth["R"], truth["t"]
        name = f"cam{k:02d}"
        cameras.append(Camera(name, document["width"], document["height"], np.array(truth["K"]), np.array(truth["dist"]), pose))
        with av.open(str(folder / "takes" / TAKE / f"{name}.mp4")) as container:
            wanted = round((STILL_S - starts[k]) * document["fps"])
            for number, frame in enumerate(container.decode(video=0)):
                if number == wanted:
                    images.append(frame.to_ndarray(format="bgr24"))
                    break
    mesh = np.load(folder / "truth" / f"{TAKE}.npz")
    nearest = np.abs(mesh["time_s"] - STILL_S).argmin()
    vertices = mesh["first_m"] + mesh["vertices_mm_i16"][nearest] * 4e-6
    return Rig(tuple(cameras)), images, vertices, np.load(folder / "truth" / "topology.npz")["faces"]


def seen_surface(rig: Rig, vertices: np.ndarray, faces: np.ndarray, count: int = 100_000) -> np.ndarray:
    """Points (n, 3) spread evenly over the true surface that at least three cameras see within 75 degrees."""
    rng = np.random.default_rng(0)
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normals, axis=1)
    picked = rng.choice(len(faces), count, p=area / area.sum())
    points = np.einsum("nc,ncd->nd", rng.dirichlet(np.ones(3), count), corners[picked])
    normal = normals[picked] / area[picked, None]
    seen = np.zeros(count, int)
    for camera in rig:
        depth = rasterise(camera, vertices, faces).depth
        pixels, z = camera.project(points)
        column, row = np.rint(np.clip(np.nan_to_num(pixels, nan=-1), -1, 1e6)).astype(int).T
        inside = (column >= 0) & (row >= 0) & (column < camera.width) & (row < camera.height)
        hit = np.full(count, np.inf)
        hit[inside] = depth[row[inside], column[inside]]
        away = camera.centre - points
        facing = (away * normal).sum(1) / np.linalg.norm(away, axis=1)
        seen += (np.abs(hit - z) < 1.5e-3) & (facing > np.cos(np.deg2rad(75)))
    return points[seen >= 3]


def accuracy(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray, surface: np.ndarray) -> dict[str, float]:
    """The four figures of a reconstruction, and the number of points."""
    import open3d

    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(vertices.astype(np.float32), faces.astype(np.uint32))
    error_mm = scene.compute_distance(np.asarray(points, np.float32)).numpy() * 1e3
    gap_mm = cKDTree(points).query(surface, distance_upper_bound=2e-3)[0] * 1e3
    return {
        "points": len(points),
        "error_median_mm": float(np.median(error_mm)),
        "error_p90_mm": float(np.quantile(error_mm, 0.9)),
        "completeness_half_mm": float((gap_mm < 0.5).mean() * 100),
        "completeness_1mm": float((gap_mm < 1).mean() * 100),
    }


def sgbm_points(rig: Rig, images: list[np.ndarray]) -> np.ndarray:
    """Points (n, 3) of OpenCV's semi-global matching over 14 rectified pairs that a third view's pair confirms."""
    views = pinhole_views(rig, images, None, SETTINGS)
    parts = [_pair_points(views[left], views[right], rig) for left, right in PAIRS]
    owner = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    points = np.concatenate(parts)
    confirmed = np.zeros(len(points), bool)
    trees = [cKDTree(part) for part in parts]
    for k, part in enumerate(parts):
        others = [tree.query(part, distance_upper_bound=5e-4)[0] < 5e-4 for j, tree in enumerate(trees) if j != k]
        confirmed[owner == k] = np.any(others, axis=0)
    kept = points[confirmed]
    _, first = np.unique(np.floor(kept / 4e-4).astype(np.int64), axis=0, return_index=True)
    return kept[first]


def _pair_points(one, other, rig: Rig) -> np.ndarray:
    """Points of one rectified pair, checked left against right, near the subject."""
    vertical = abs((other.camera.centre - one.camera.centre)[1]) > 0.5 * np.linalg.norm(other.camera.centre - one.camera.centre)
    turn = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]) if vertical else np.eye(3)
    poses = [turn @ view.camera.camera_from_world[:3] for view in (one, other)]
    if (poses[1][:, :3] @ (one.camera.centre - other.camera.centre))[0] > 0:
        one, other, poses = other, one, poses[::-1]
    rotation = poses[1][:, :3] @ poses[0][:, :3].T
    shift = poses[1][:, 3] - rotation @ poses[0][:, 3]
    base = shift / np.linalg.norm(shift)
    x = -(poses[0][:, :3].T @ rotation.T @ base)  # along the base, world
    z = one.camera.axis + other.camera.axis
    z -= (z @ x) * x
    z /= np.linalg.norm(z)
    new = np.stack([x, np.cross(z, x), z])
    size, focal = (1100, 1100), one.camera.matrix[0, 0]
    middle = subject_centre(rig)
    greys, matrices = [], []
    for view in (one, other):
        local = new @ (middle - view.camera.centre)
        matrix = np.array(
            [[focal, 0, 550 - focal * local[0] / local[2]], [0, focal, 550 - focal * local[1] / local[2]], [0, 0, 1]]
        )
        warp = matrix @ new @ view.camera.camera_from_world[:3, :3].T @ np.linalg.inv(view.camera.matrix)
        greys.append(cv2.warpPerspective(view.colour, warp, size, flags=cv2.INTER_CUBIC))
        matrices.append(matrix)
    # both principal points were laid on the subject's middle, so that disparities there are about zero
    block = 5
    matcher = cv2.StereoSGBM_create(
        -DISPARITIES // 2, DISPARITIES, block, 8 * block**2, 32 * block**2, 1, 31, 10, 100, 2, cv2.STEREO_SGBM_MODE_SGBM_3WAY
    )
    disparity = matcher.compute(greys[0], greys[1]).astype(np.float64) / 16
    width = np.linalg.norm(other.camera.centre - one.camera.centre)
    offset = matrices[0][0, 2] - matrices[1][0, 2]
    rows, columns = np.nonzero((disparity > -DISPARITIES // 2) & (greys[0].max(2) > 90))
    depth = focal * width / (disparity[rows, columns] - offset)
    rays = np.stack([columns, rows, np.ones(len(rows))], 1) @ np.linalg.inv(matrices[0]).T
    points = (rays * depth[:, None]) @ new + one.camera.centre
    return points[(np.linalg.norm(points - middle, axis=1) < 0.3) & (depth > 0)]


def large_frame(rig: Rig, images: list[np.ndarray]) -> dict[str, float]:
    """Seconds and memory of the same frame at twice the size."""
    doubled = Rig(tuple(camera.scaled(2.0) for camera in rig))
    enlarged = [
        cv2.resize(image, camera.size, interpolation=cv2.INTER_CUBIC) for image, camera in zip(images, doubled, strict=True)
    ]
    took = measure(lambda: reconstruct_frame(doubled, enlarged, time_s=STILL_S, settings=SETTINGS))
    return {"large_cpu_seconds": took["cpu_seconds"], "large_peak_memory_gib": peak_memory_gib()}
