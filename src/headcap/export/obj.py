"""A mesh as Wavefront OBJ: the topology that goes with a point cache."""

from pathlib import Path

from numpy.typing import NDArray
from PIL import Image

from headcap.artifacts import atomic_path
from headcap.registration.template import Template


def write_obj(path: Path | str, template: Template, vertices: NDArray | None = None) -> None:
    """Write a template, or its topology at other positions (n, 3), as OBJ; metres, vertices in the template's order.

    A texture is written beside it as PNG, with an MTL file that names it.
    """
    path = Path(path)
    positions = template.vertices if vertices is None else vertices
    if positions.shape != template.vertices.shape:
        raise ValueError(f"positions {positions.shape} do not fit the template's {template.vertices.shape}")
    lines = _material(path, template)
    lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in positions.tolist()]
    lines += [f"vt {u:.9g} {1 - v:.9g}" for u, v in template.uv.tolist()]
    corners = zip((template.triangles + 1).tolist(), (template.uv_triangles + 1).tolist(), strict=True)
    lines += [f"f {a}/{i} {b}/{j} {c}/{k}" for (a, b, c), (i, j, k) in corners]
    with atomic_path(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n")


def _material(path: Path, template: Template) -> list[str]:
    if template.texture is None:
        return []
    with atomic_path(path.with_suffix(".png")) as temporary:
        Image.fromarray(template.texture).save(temporary, "png")
    with atomic_path(path.with_suffix(".mtl")) as temporary:
        temporary.write_text(f"newmtl skin\nKd 1 1 1\nmap_Kd {path.stem}.png\n")
    return [f"mtllib {path.stem}.mtl", "usemtl skin"]
