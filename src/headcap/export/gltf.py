"""A textured mesh as one binary glTF 2.0 file: metres, y up, texture inside."""

from pathlib import Path

import trimesh
from numpy.typing import NDArray
from PIL import Image

from headcap.artifacts import atomic_path
from headcap.export.seams import split_at_seams
from headcap.registration.template import Template


def write_glb(path: Path | str, template: Template, vertices: NDArray | None = None) -> None:
    """Write a template, or its topology at other positions (n, 3), as GLB.

    Vertices are split at texture seams, so their number and order differ from the template's.
    """
    split = split_at_seams(template)
    positions = template.vertices if vertices is None else vertices
    if positions.shape != template.vertices.shape:
        raise ValueError(f"positions {positions.shape} do not fit the template's {template.vertices.shape}")
    # trimesh counts v upwards and turns it again when it writes
    uv = split.uv * [1.0, -1.0] + [0.0, 1.0]
    material = None
    if template.texture is not None:
        material = trimesh.visual.material.PBRMaterial(
            baseColorTexture=Image.fromarray(template.texture), metallicFactor=0.0, roughnessFactor=0.7
        )
    visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    mesh = trimesh.Trimesh(positions[split.source], split.triangles, visual=visual, process=False)
    with atomic_path(path) as temporary:
        temporary.write_bytes(trimesh.Scene(mesh).export(file_type="glb"))
