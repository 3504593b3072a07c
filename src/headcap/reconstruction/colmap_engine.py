"""COLMAP as an engine: CUDA patch match to depth maps, and its fusion of anyone's depth maps."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.cameras import Rig
from headcap.errors import InputError
from headcap.reconstruction.colmap_files import ball_tracks, map_tracks, read_depth_maps, write_depth_maps, write_workspace
from headcap.reconstruction.maps import DepthMap
from headcap.reconstruction.points import PointCloud
from headcap.reconstruction.settings import ReconstructSettings
from headcap.reconstruction.views import choose_sources, depth_range, pinhole_views, subject_centre

_FUSED = np.dtype([(name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")] + [(name, "u1") for name in ("r", "g", "b")])


def has_cuda() -> bool:
    """Whether this machine's pycolmap can run patch match."""
    import pycolmap

    return bool(pycolmap.has_cuda)


def estimate_maps_colmap(
    rig: Rig, images_bgr: list[NDArray[np.uint8]], *, settings: ReconstructSettings, masks: list[NDArray] | None = None
) -> list[DepthMap]:
    """Depth maps at full resolution from COLMAP's CUDA patch match with geometric consistency.

    Same arguments and errors as `estimate_maps`; `InputError` also where there is no CUDA and where maps come back empty.
    """
    import pycolmap

    if not pycolmap.has_cuda:
        raise InputError(
            "engine 'colmap' without CUDA",
            expected="a pycolmap built with CUDA (pycolmap-cuda12) and a GPU",
            remedy="Use engine 'patchmatch' or 'auto'.",
        )
    views = pinhole_views(rig, images_bgr, masks, settings)
    rig = Rig(tuple(view.camera for view in views))
    centre = subject_centre(rig)
    ranges = depth_range(rig, centre, settings)
    options = pycolmap.PatchMatchOptions()
    options.gpu_index, options.geom_consistency, options.filter = settings.gpu_index, True, True
    options.depth_min, options.depth_max = float(ranges[:, 0].min()), float(ranges[:, 1].max())
    with tempfile.TemporaryDirectory(prefix="headcap-colmap-") as name:
        folder = Path(name)
        tracks = ball_tracks(list(rig), centre, 0.4 * float(np.median(ranges[:, 1] - ranges[:, 0])) / 2)
        sources = choose_sources(rig, centre, settings.matching)
        write_workspace(folder, list(rig), [view.colour for view in views], sources, tracks)
        pycolmap.patch_match_stereo(folder, options=options)
        matched = [index for index, chosen in enumerate(sources) if len(chosen)]
        maps = read_depth_maps(folder, [rig[k] for k in matched], [views[k].colour for k in matched])
    return [_masked(depth_map, views[index].valid) for index, depth_map in zip(matched, maps, strict=True)]


def _masked(depth_map: DepthMap, valid: NDArray[np.bool_]) -> DepthMap:
    return replace(depth_map, depth=np.where(valid, depth_map.depth, 0).astype(np.float32), chosen=depth_map.chosen & valid)


def fuse_colmap(maps: list[DepthMap], *, time_s: float, settings: ReconstructSettings) -> PointCloud:
    """Fuse depth maps with COLMAP's `stereo_fusion`; confidence is 1, as it gives none.

    Its limits are set for a face at arm's length: 0.1 % of depth, 25 degrees, 1.5 cells (its defaults are 10 mm at 1 m).
    """
    import pycolmap

    options = pycolmap.StereoFusionOptions()
    options.min_num_pixels = max(2, settings.fusion.min_views)
    options.max_depth_error, options.max_normal_error, options.max_reproj_error = 0.001, 25.0, 1.5
    options.num_threads = 1
    with tempfile.TemporaryDirectory(prefix="headcap-fusion-") as name:
        folder = Path(name)
        everyone = [[other for other in range(len(maps)) if other != view] for view in range(len(maps))]
        images = [np.ascontiguousarray(depth_map.colour[..., ::-1]) for depth_map in maps]
        write_workspace(folder, [depth_map.camera for depth_map in maps], images, everyone, map_tracks(maps))
        write_depth_maps(folder, maps)
        output = folder / "fused.ply"
        pycolmap.stereo_fusion(output, folder, options=options, output_type="ply")
        points = _read_fused(output)
    if not len(points):
        raise InputError("stereo_fusion found no point", expected="overlapping depth maps", remedy="Use fusion_engine 'headcap'.")
    stack = lambda *names: np.stack([points[name] for name in names], 1)  # noqa: E731
    ones = np.ones(len(points), np.float32)
    return PointCloud(stack("x", "y", "z"), stack("nx", "ny", "nz"), ones, stack("r", "g", "b"), time_s)


def _read_fused(path: Path) -> NDArray:
    head, _, body = path.read_bytes().partition(b"end_header\n")
    count = next(int(line.split()[2]) for line in head.decode().splitlines() if line.startswith("element vertex"))
    return np.frombuffer(body, _FUSED, count)
