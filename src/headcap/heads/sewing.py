"""From the flat half to the whole head: lift, open the mouth, sew the pocket, mirror, name regions and landmarks."""

from dataclasses import dataclass

import numpy as np
from matplotlib.path import Path as Polygon
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import Delaunay

from headcap.heads import sculpt
from headcap.heads.cutting import Plane

# the mouth pocket ring by ring from the lip line inwards: depth and half opening in mm, width as a share of the mouth's
POCKET_RINGS = (
    (1.6, 0.25, 1.0), (3.4, 0.7, 0.99), (5.6, 1.5, 0.97), (8.5, 3.0, 0.95), (12.5, 5.0, 0.90), (17.5, 7.0, 0.80),
    (22.5, 7.5, 0.62), (26.5, 6.0, 0.36),
)  # fmt: skip
POCKET_DEPTH_MM = 28.5


@dataclass(frozen=True)
class Half:
    """The half head with x >= 0 in space, mouth open."""

    vertices: NDArray
    """(n, 3) millimetres; exactly 0 in x on the midline."""
    triangles: NDArray
    pocket: NDArray
    """(m,) true for triangles of the mouth pocket."""
    marks: dict[str, NDArray]
    """Named vertices: slit_upper, slit_lower (midline to corner), eye, bottom, rings of the pocket."""


def lift(plane: Plane, points: NDArray, chains: dict[str, NDArray], eye: NDArray) -> NDArray:
    """Vertices (k, 3) of flat points (k, 2) on the sculpted surface; those inside the lids on the eyeball."""
    space = LinearNDInterpolator(plane.flat, plane.space)(points)
    lost = np.isnan(space).any(1)
    nearest = np.linalg.norm(points[lost, None] - plane.flat[None], axis=2).argmin(1)
    space[lost] = plane.space[nearest]
    border = chains["border"]
    bottom = border[space[border, 1] < sculpt.NECK_CUT_MM + 1.0]
    middle = border[space[border, 0] < 0.4]
    space[middle, 0] = 0.0
    lifted = sculpt.project(space)
    lifted[bottom] = sculpt.project(space[bottom], axes=(1, 0, 1))
    lifted[bottom, 1] = sculpt.NECK_CUT_MM
    lifted[middle, 0] = 0.0
    lifted[chains["slit"], 1] = sculpt.mouth_line(lifted[chains["slit"], 0])
    lifted[chains["slit"]] = sculpt.project(lifted[chains["slit"]], axes=(0, 0, 1))
    ball = lifted[eye] - sculpt.PUPIL_MM
    reach = np.maximum(sculpt.EYE_RADIUS_MM**2 - ball[:, 0] ** 2 - ball[:, 1] ** 2, 25.0)
    lifted[eye, 2] = np.minimum(lifted[eye, 2] - 0.7, sculpt.PUPIL_MM[2] + np.sqrt(reach))
    return lifted


def inside_rim(points: NDArray, chains: dict[str, NDArray]) -> NDArray[np.int64]:
    """Flat points (k, 2) strictly inside the lid rim."""
    inside = Polygon(points[chains["rim"]]).contains_points(points)
    inside[chains["rim"]] = False
    return np.flatnonzero(inside)


def open_mouth(vertices: NDArray, flat: NDArray, triangles: NDArray, chains: dict[str, NDArray]) -> Half:
    """Double the lip line's vertices (the corner stays one) and sew the pocket between the two sides."""
    slit = chains["slit"]
    lower = np.append(np.arange(len(slit) - 1) + len(vertices), slit[-1])
    below = _side_of(flat[triangles].mean(1), flat[slit]) < 0
    renamed = np.arange(len(vertices))
    renamed[slit[:-1]] = lower[:-1]
    triangles = np.where(below[:, None], renamed[triangles], triangles)
    gap = 0.12 * (1.0 - np.linspace(0, 1, len(slit)) ** 4)
    vertices = np.concatenate([vertices, vertices[slit[:-1]] - gap[:-1, None] * [0, 1, 0]])
    vertices[slit] += gap[:, None] * [0, 1, 0]
    loop = np.concatenate([slit, lower[-2::-1]])
    added, pocket, rings = _pocket(vertices[loop])
    names = np.concatenate([loop, np.arange(len(added)) + len(vertices)])
    marks = {"slit_upper": slit, "slit_lower": lower} | {name: names[ring] for name, ring in rings.items()}
    return Half(
        vertices=np.concatenate([vertices, added]),
        triangles=np.concatenate([triangles, names[pocket]]).astype(np.int32),
        pocket=np.arange(len(triangles) + len(pocket)) >= len(triangles),
        marks=marks,
    )


def mirror(half: Half) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Whole head: vertices, triangles, partner (n,) of each vertex across x = 0, and pocket (m,)."""
    n = len(half.vertices)
    middle = half.vertices[:, 0] == 0.0
    partner = np.arange(n)
    partner[~middle] = n + np.arange((~middle).sum())
    vertices = np.concatenate([half.vertices, half.vertices[~middle] * [-1, 1, 1]])
    triangles = np.concatenate([half.triangles, partner[half.triangles[:, ::-1]]]).astype(np.int32)
    back = np.concatenate([partner, np.flatnonzero(~middle)])
    return vertices, triangles, back, np.concatenate([half.pocket, half.pocket])


def _side_of(points: NDArray, chain: NDArray) -> NDArray:
    """Positive on the left of a chain of flat points, by its nearest segment; 0 beyond its far end."""
    start, end = chain[:-1], chain[1:]
    axis = end - start
    along = np.clip(np.einsum("psk,sk->ps", points[:, None] - start, axis) / (axis**2).sum(1), 0, 1)
    away = points[:, None] - start - along[..., None] * axis
    nearest = np.linalg.norm(away, axis=2).argmin(1)
    off = points - start[nearest]
    return axis[nearest, 0] * off[:, 1] - axis[nearest, 1] * off[:, 0]


def _pocket(loop: NDArray) -> tuple[NDArray, NDArray, dict[str, NDArray]]:
    """Vertices inside the pocket (k, 3), its triangles over loop + those, and the rings' indices.

    The pocket is a half disc: the lip line is its half circle (upper midline, corner, lower midline), its centre the back.
    """
    n = len(loop)
    theta = np.linspace(np.pi / 2, -np.pi / 2, n)
    disc, space, rings, begin = [_circle(1.0, theta)], [], {}, n
    for k, ring in enumerate(POCKET_RINGS):
        count = n if k < 4 else max(5, (n - 1) // 2 * 2 // (k - 2) // 2 * 2 + 1)
        at = np.linspace(np.pi / 2, -np.pi / 2, count)
        disc.append(_circle(1.0 - (k + 1) / (len(POCKET_RINGS) + 1), at))
        space.append(_ring_in_space(loop, theta, at, *ring))
        rings[f"pocket_{k + 1}"] = np.arange(begin, begin + count)
        begin += count
    disc.append(np.zeros((1, 2)))
    middle = loop[0]
    space.append(np.array([[0.0, middle[1] - 1.0, middle[2] - POCKET_DEPTH_MM]]))
    flat = np.concatenate(disc)
    triangles = Delaunay(flat).simplices
    a, b, c = flat[triangles].transpose(1, 0, 2)
    area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    triangles = triangles[np.abs(area) > 1e-9]
    turned = area[np.abs(area) > 1e-9] < 0
    triangles[turned] = triangles[turned][:, ::-1]
    return np.concatenate(space), triangles, rings


def _circle(radius: float, theta: NDArray) -> NDArray:
    points = radius * np.stack([np.cos(theta), np.sin(theta)], axis=1)
    points[[0, -1], 0] = 0.0
    return points


def _ring_in_space(loop: NDArray, theta: NDArray, at: NDArray, depth: float, opening: float, width: float) -> NDArray:
    on_lip = np.stack([np.interp(-at, -theta, loop[:, axis]) for axis in range(3)], axis=1)
    centre = loop[[0]]
    tall = np.sign(np.sin(at)) * np.abs(np.sin(at)) ** 0.7
    tall[np.abs(np.sin(at)) < 1e-9] = 0.0
    out = centre + (on_lip - centre) * width
    out[:, 1] += opening * tall
    out[:, 2] -= depth
    out[[0, -1], 0] = 0.0
    return out


def regions(vertices: NDArray, triangles: NDArray, pocket: NDArray, marks: dict[str, NDArray]) -> dict[str, NDArray]:
    """Named masks (n,) from where vertices lie on the sculpt; `marks` holds both halves."""
    x, y, z = np.abs(vertices[:, 0]), vertices[:, 1], vertices[:, 2]
    n = len(vertices)
    mask = {name: np.isin(np.arange(n), marks[name]) for name in marks}
    inner = np.isin(np.arange(n), np.unique(triangles[pocket]))
    lips = _on_lips(vertices) & ~inner
    upper_side = y > sculpt.mouth_line(x)
    roll = inner & np.isin(np.arange(n), np.concatenate([marks[f"pocket_{k}"] for k in (1, 2, 3)]))
    slit_upper, slit_lower = mask["slit_upper"], mask["slit_lower"]
    up, down = slit_upper | (roll & upper_side), slit_lower | (roll & ~upper_side)
    ears = _on_ear(vertices)
    jaw = np.interp(z, [-30, 5, 50, 75], [-62, -88, -113, -122])
    neck = (y < jaw) | ((z < -10) & (y < -62) & (x < 90))
    scalp = ((y > 70) | (z < 12)) & ~neck & ~ears
    face = ~(scalp | neck | ears | inner) & ~mask["eye"] | slit_upper | slit_lower
    larynx = (np.linalg.norm((vertices - [0, -155, 38]) / [24, 30, 22], axis=1) < 1) & neck
    return {
        "face": face,
        "neck": neck,
        "scalp": scalp,
        "ears": ears,
        "eyes": mask["eye"],
        "lid_rims": mask["rim"],
        "lips_upper": (lips & upper_side) | slit_upper,
        "lips_lower": (lips & ~upper_side) | slit_lower,
        "lips_inner_upper": up,
        "lips_inner_lower": down,
        "mouth_interior": inner & ~(slit_upper | slit_lower | roll),
        "larynx": larynx,
    }


def landmarks(vertices: NDArray, marks: dict[str, NDArray], rim: NDArray, partner: NDArray) -> dict[str, int]:
    """Named vertices by their place on the sculpt; left is the subject's left (+x)."""
    half = vertices[:, 0] >= 0

    def nearest(point: tuple[float, float, float]) -> int:
        """The vertex with x >= 0 nearest to a point; on the midline where the point is."""
        away = np.linalg.norm(vertices - np.array(point), axis=1) + np.where(half, 0.0, 1e6)
        away += np.where((point[0] == 0.0) & (vertices[:, 0] != 0.0), 1e6, 0.0)
        return int(away.argmin())

    rim = rim[vertices[rim, 0] > 0]
    middle = np.flatnonzero(vertices[:, 0] == 0.0)
    single = {
        "nose_tip": int(middle[vertices[middle, 2].argmax()]),
        "nose_bridge": nearest((0, 5, 92)),
        "subnasale": nearest((0, -48, 99)),
        "glabella": nearest((0, 20, 97)),
        "crown": int(vertices[:, 1].argmax()),
        "back_of_head": int(middle[vertices[middle, 2].argmin()]) if len(middle) else 0,
        "chin": nearest((0, -98, 97)),
        "menton": nearest((0, -114, 82)),
        "larynx": nearest((0, -152, 45)),
        "mouth_upper": int(marks["slit_upper"][0]),
        "mouth_lower": int(marks["slit_lower"][0]),
        "lip_upper_top": nearest((0, -59, 103)),
        "lip_lower_bottom": nearest((0, -77, 102)),
    }
    paired = {
        "mouth_corner": _corner(vertices, marks),
        "eye_inner": int(rim[vertices[rim, 0].argmin()]),
        "eye_outer": int(rim[vertices[rim, 0].argmax()]),
        "eye_top": int(rim[vertices[rim, 1].argmax()]),
        "eye_bottom": int(rim[vertices[rim, 1].argmin()]),
        "nose_wing": nearest((19, -40, 100)),
        "ear_top": int(np.flatnonzero(_on_ear(vertices) & half)[vertices[_on_ear(vertices) & half, 1].argmax()]),
        "ear_lobe": int(np.flatnonzero(_on_ear(vertices) & half)[vertices[_on_ear(vertices) & half, 1].argmin()]),
        "jaw_angle": nearest((56, -70, 2)),
        "cheekbone": nearest((60, -18, 56)),
    }
    sided = {f"{name}_left": v for name, v in paired.items()} | {f"{name}_right": int(partner[v]) for name, v in paired.items()}
    return single | sided


def _corner(vertices: NDArray, marks: dict[str, NDArray]) -> int:
    line = marks["slit_upper"]
    return int(line[vertices[line, 0].argmax()])


def _on_lips(vertices: NDArray) -> NDArray[np.bool_]:
    """The vermilion: an outline around the lip line, tapering to the corners."""
    x = np.abs(vertices[:, 0])
    t = np.clip(1.0 - (x / (sculpt.MOUTH_HALF_WIDTH_MM + 0.5)) ** 2, 0.0, 1.0)
    off = vertices[:, 1] - sculpt.mouth_line(x)
    bow = 8.0 - 1.3 * np.exp(-((x / 3.0) ** 2))
    return (vertices[:, 2] > 70) & (x < sculpt.MOUTH_HALF_WIDTH_MM + 0.4) & (off < bow * t**0.8) & (off > -9.8 * t**0.75)


def _on_ear(vertices: NDArray) -> NDArray[np.bool_]:
    """What stands off the skull around the ear's root."""
    p = np.abs(vertices * [1, 0, 0]) + vertices * [0, 1, 1]
    q = (p - [80.0, -8.0, -14.0]) / [18.0, 38.0, 27.0]
    return (np.linalg.norm(q, axis=1) < 1.0) & (p[:, 0] > 71.0)
