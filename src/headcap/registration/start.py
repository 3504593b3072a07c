"""The first frame: the placed template drawn onto its point cloud, then coloured by all cameras."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from headcap.cameras import Rig
from headcap.reconstruction.points import PointCloud
from headcap.registration.correspondence import ViewFlow, pairs_normal, point_pairs
from headcap.registration.graph import GraphSolver, build_graph
from headcap.registration.photometric import Normal
from headcap.registration.refine import Refiner
from headcap.registration.render import project
from headcap.registration.template import Template
from headcap.registration.texture import bake_from_cameras
from headcap.registration.track_settings import TrackSettings


def prepare_start(
    template: Template, rig: Rig, images: list[NDArray[np.uint8] | None], cloud: PointCloud | None, settings: TrackSettings
) -> Template:
    """The template at a take's first frame, in the world, textured by all cameras.

    `template` already stands in the rig's world (`place_template`); `images` are the BGR photographs of the first frame, None for
    a camera without one; `cloud` its points, or None to trust the placement.
    """
    if cloud is not None and len(cloud) > 0:
        template = template.with_vertices(snap(template, rig, cloud, settings))
    return bake_from_cameras(template, rig, images, settings.texture_size_px)


def snap(template: Template, rig: Rig, cloud: PointCloud, settings: TrackSettings) -> NDArray[np.float64]:
    """Vertices (n, 3) drawn onto a cloud: by the deformation graph first, then vertex by vertex.

    Points pull along their normals only: the template slides as little as its stiffness allows.
    """
    triangles = template.triangles
    graph = build_graph(template.vertices, triangles, settings.graph)
    solver = GraphSolver(graph, settings.graph)
    pose, displacement = graph.rest, np.zeros_like(template.vertices)
    for _ in range(settings.start_rounds):
        surface = graph.deform(pose)
        pose = solver.step(pose, _pull(surface, triangles, rig, cloud, settings), surface)
    surface = graph.deform(pose)
    refiner = Refiner(template.vertices, triangles, settings.refine)
    for _ in range(settings.start_rounds):
        normal = _pull(surface + displacement, triangles, rig, cloud, settings)
        displacement += refiner.solve(normal, displacement)
    return surface + displacement


def _pull(vertices: NDArray, triangles: NDArray, rig: Rig, cloud: PointCloud, settings: TrackSettings) -> Normal:
    views = []
    for camera in rig:
        projection = project(camera, vertices, triangles)
        views.append(ViewFlow(camera, projection, None, projection.raster.hit, None))
    still = [np.zeros_like(vertices)] * len(views)
    pairs = point_pairs(cloud, views, still, vertices, triangles, settings.correspondence)
    return pairs_normal(pairs, vertices, triangles, settings.correspondence, slide=True)
