"""The base head: a generic adult in the model's topology, made from nothing but `sculpt`.

About 13 thousand vertices, one oriented manifold skin, symmetric about x = 0, open at the bottom only. The lips part
along a slit with a pocket behind it; the eyes are surfaces set in behind the lids' rims.
"""

from functools import lru_cache
from pathlib import Path

import numpy as np

from headcap.artifacts import load_arrays, save_arrays
from headcap.registration.template import Template

KIND, SCHEMA = "base_head", 1
STORE = Path(__file__).with_name("base_head.npz")


@lru_cache(maxsize=1)
def base_head() -> Template:
    """The stored base head, in metres, y up, z out of the face, origin between the ears.

    Regions: face, neck, scalp, ears, eyes, lid_rims, lips_upper, lips_lower, lips_inner_upper, lips_inner_lower, mouth_interior,
    larynx. The lip line's two sides are the first of `lips_inner_upper` and `lips_inner_lower` that touch the skin; their
    vertices come in pairs (`lip_pairs`).
    """
    arrays, meta = load_arrays(STORE, KIND, SCHEMA)
    regions = {name.removeprefix("region/"): arrays[name] for name in arrays if name.startswith("region/")}
    return Template(
        vertices=arrays["vertices"],
        triangles=arrays["triangles"],
        uv=arrays["uv"],
        uv_triangles=arrays["uv_triangles"],
        regions=regions,
        landmarks=meta["landmarks"],
    )


def mirror_partners() -> np.ndarray:
    """(n,) the vertex across x = 0 from each vertex of the base head; itself on the midline."""
    return load_arrays(STORE, KIND, SCHEMA)[0]["partner"]


def lip_pairs() -> np.ndarray:
    """(k, 2) upper and lower vertex of the lip line from right corner to left; both are one vertex at the corners."""
    return load_arrays(STORE, KIND, SCHEMA)[0]["lip_pairs"]


def eye_rims() -> np.ndarray:
    """(2, k) vertices of the lids' rims in order around the eye, the subject's left eye first."""
    return load_arrays(STORE, KIND, SCHEMA)[0]["eye_rims"]


def build() -> None:
    """Sculpt, cut, sew and unwrap the head and write it beside this module."""
    # here and not above: every job loads the head, and none makes it
    from headcap.heads import cutting, sewing

    plane = cutting.flatten_half()
    points, triangles, chains = cutting.triangulate(plane)
    eye = sewing.inside_rim(points, chains)
    skin = sewing.lift(plane, points, chains, eye)
    half = sewing.open_mouth(skin, points, triangles, chains)
    vertices, whole, partner, pocket = sewing.mirror(half)
    marks = {name: np.unique(np.concatenate([i, partner[i]])) for name, i in half.marks.items()}
    rim = np.stack([chains["rim"], partner[chains["rim"]]])
    marks |= {"eye": np.concatenate([eye, partner[eye]]), "rim": rim.ravel()}
    uv, uv_triangles = _texture_coordinates(skin, triangles, chains, vertices, whole, pocket)
    upper, lower = half.marks["slit_upper"], half.marks["slit_lower"]
    left = np.stack([upper, lower], axis=1)
    arrays = {
        "vertices": vertices * 1e-3,
        "triangles": whole.astype(np.int32),
        "uv": uv,
        "uv_triangles": uv_triangles.astype(np.int32),
        "partner": partner.astype(np.int32),
        "lip_pairs": np.concatenate([partner[left][:0:-1], left]).astype(np.int32),
        "eye_rims": rim.astype(np.int32),
    }
    regions = sewing.regions(vertices, whole, pocket, marks)
    arrays |= {f"region/{name}": mask for name, mask in regions.items()}
    places = {"slit_upper": upper, "slit_lower": lower}
    save_arrays(STORE, KIND, SCHEMA, arrays, {"landmarks": sewing.landmarks(vertices, places, rim.ravel(), partner)})


def _texture_coordinates(skin, half_triangles, chains, vertices, whole, pocket) -> tuple[np.ndarray, np.ndarray]:
    """Skin chart over the head with its lips closed, cut along the back; the pocket's chart beside it."""
    from headcap.heads import sewing, unwrapping

    closed = sewing.Half(skin, half_triangles, np.zeros(len(half_triangles), bool), {})
    shut, triangles, _, _ = sewing.mirror(closed)
    border = chains["border"]
    middle = border[skin[border, 0] == 0.0]
    crown = int(np.argmax(skin[middle, 1] - 0.6 * skin[middle, 2]))
    behind = middle[: crown + 1] if skin[middle[0], 2] < skin[middle[-1], 2] else middle[crown:][::-1]
    chain = behind[::-1]
    sides = np.arange(len(triangles)) >= len(half_triangles)
    opened, origin = unwrapping.cut_open(triangles, chain, sides, len(shut))
    flat = unwrapping.unwrap_disc(unwrapping.shrunken_scalp(shut[origin]), opened)
    flat = _upright(flat, shut[origin])
    inside, inside_triangles = unwrapping.chart_of(vertices, whole, pocket)
    skin_uv, pocket_uv = unwrapping.lay_out(flat, inside)
    uv_triangles = np.empty_like(whole)
    uv_triangles[~pocket] = opened
    uv_triangles[pocket] = inside_triangles + len(flat)
    return np.concatenate([skin_uv, pocket_uv]), uv_triangles


def _upright(flat: np.ndarray, space: np.ndarray) -> np.ndarray:
    """The chart turned so that the face's up is up and its left (+x) is right."""
    front = space[:, 2] > 40
    a = np.linalg.lstsq(np.c_[space[front, :2], np.ones(front.sum())], flat[front], rcond=None)[0][:2]
    u, _, vt = np.linalg.svd(a)
    return flat @ (u @ vt).T
