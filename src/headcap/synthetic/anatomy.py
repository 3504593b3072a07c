"""Places and soft weight fields on a head, from which its motion is built: hinge, neck, lips, lids, larynx."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from headcap.meshes.laplacian import Factor, cotangent_laplacian
from headcap.registration.template import Template


@dataclass(frozen=True)
class Places:
    """Points of a head at rest, metres, x to the subject's left, y up, z out of the face."""

    mouth_left: NDArray[np.float64]
    mouth_right: NDArray[np.float64]
    mouth: NDArray[np.float64]
    """Where the lips meet, on the midline."""
    hinge: NDArray[np.float64]
    """Middle of the jaw's axis, which runs along x."""
    chin: NDArray[np.float64]
    eye_left: NDArray[np.float64]
    eye_right: NDArray[np.float64]
    """Centres of the eyeballs."""
    eye_radius: float
    larynx: NDArray[np.float64]
    """On the skin of the neck, midline."""
    neck_low: NDArray[np.float64]
    neck_high: NDArray[np.float64]
    """Ends of the neck's bending axis."""


def find_places(head: Template) -> Places:
    """Places from the regions of a template; its landmarks are not needed."""
    v, regions = head.vertices, head.regions
    lips = v[regions["lips_upper"] | regions["lips_lower"]]
    left, right = lips[lips[:, 0].argmax()], lips[lips[:, 0].argmin()]
    seam = np.concatenate([v[regions["lips_inner_upper"]], v[regions["lips_inner_lower"]]])
    mouth = seam[np.abs(seam[:, 0]) < 0.2 * (left[0] - right[0])].mean(0) * [0, 1, 1]
    ears, eyes = v[regions["ears"]], v[regions["eyes"]]
    hinge = np.array([0.0, ears[:, 1].mean() - 0.008, ears[:, 2].mean() + 0.018])
    below = v[(np.abs(v[:, 0]) < 0.012) & (v[:, 1] < mouth[1] - 0.022) & (v[:, 1] > mouth[1] - 0.05)]
    chin = below[below[:, 2].argmax()] * [0, 1, 1]
    eye_left, eye_right = (_eye_centre(eyes[eyes[:, 0] * side > 0]) for side in (1, -1))
    front = v[(np.abs(v[:, 0]) < 0.006) & (np.abs(v[:, 1] - (chin[1] - 0.054)) < 0.008) & (v[:, 2] > hinge[2])]
    larynx = front.mean(0) * [0, 1, 1]
    low = np.array([0.0, v[regions["neck"], 1].min() + 0.03, larynx[2] - 0.075])
    return Places(
        left, right, mouth, hinge, chin, eye_left[0], eye_right[0], 0.5 * (eye_left[1] + eye_right[1]),
        larynx, low, np.array([0.0, hinge[1] - 0.025, hinge[2] - 0.012]),
    )  # fmt: skip


def _eye_centre(points: NDArray) -> tuple[NDArray, float]:
    """Centre and radius of the eyeball: the sphere of an adult's 12 mm that fits the points best (their bulge tells little)."""
    radius = 0.012
    centre = points.mean(0) - [0, 0, 0.8 * radius]
    for _ in range(50):
        away = points - centre
        distance = np.linalg.norm(away, axis=1, keepdims=True)
        centre = centre + (away * (1 - radius / distance)).mean(0)
    return centre, radius


@dataclass(frozen=True)
class Fields:
    """Soft weights of every vertex (n,), 0 to 1, harmonic on the surface so that the mouth's opening separates them."""

    head: NDArray[np.float64]
    """How far up the neck: 0 at its cut, 1 on the head."""
    jaw: NDArray[np.float64]
    upper_lip: NDArray[np.float64]
    lower_lip: NDArray[np.float64]

    def all(self) -> tuple[NDArray, ...]:
        """The fields in order."""
        return self.head, self.jaw, self.upper_lip, self.lower_lip

    def mapped(self, operator: sparse.csr_array) -> Fields:
        """The fields on a denser mesh."""
        return Fields(*(np.clip(operator @ field, 0, 1) for field in self.all()))


def solve_fields(head: Template, places: Places) -> Fields:
    """Harmonic fields between places that surely belong to a part and places that surely do not."""
    v, regions = head.vertices, head.regions
    laplacian = cotangent_laplacian(v, head.triangles, least_weight=1e-4)
    smoother = Factor(sparse.eye_array(len(v)) + 4.0 * laplacian)
    skull = regions["scalp"] | regions["ears"] | (v[:, 1] > places.mouth[1] + 0.005) & (v[:, 1] > places.hinge[1] - 0.03)
    lower_face = (v[:, 1] > places.chin[1] - 0.004) & (v[:, 2] > places.hinge[2] + 0.02)
    cut = v[:, 1] < v[:, 1].min() + 0.012
    neck = _harmonic(laplacian, smoother, skull | lower_face, cut)
    neck = np.clip((neck - neck[cut].max()) / (1 - neck[cut].max()), 0, 1)  # the shoulders stay where they are
    jaw_bone = lower_face & (_hinge_angle(v, places) < _hinge_angle(places.mouth[None], places)[0] - np.radians(9))
    lower_lip = regions["lips_lower"] | regions["lips_inner_lower"]
    upper_lip = regions["lips_upper"] | regions["lips_inner_upper"]
    corner = np.minimum(np.linalg.norm(v - places.mouth_left, axis=1), np.linalg.norm(v - places.mouth_right, axis=1)) < 0.006
    upper_face = (
        skull & (v[:, 1] > places.mouth[1] + 0.022) | (v[:, 1] < places.larynx[1] + 0.016) | (v[:, 2] < places.hinge[2] - 0.01)
    )
    jaw = _harmonic(laplacian, smoother, (jaw_bone | lower_lip) & ~corner & ~upper_face, (upper_face | upper_lip) & ~corner)
    far = np.linalg.norm(v - places.mouth, axis=1) > 0.048
    upper = _harmonic(laplacian, smoother, upper_lip & ~corner, far | lower_lip & ~corner)
    lower = _harmonic(laplacian, smoother, lower_lip & ~corner, far | upper_lip & ~corner)
    return Fields(neck, jaw, upper, lower)


def _hinge_angle(points: NDArray, places: Places) -> NDArray:
    """Elevation (n,) of points seen from the jaw's axis."""
    return np.arctan2(points[:, 1] - places.hinge[1], points[:, 2] - places.hinge[2])


def _harmonic(laplacian: sparse.csr_array, smoother: Factor, ones: NDArray, zeros: NDArray) -> NDArray[np.float64]:
    """The field (n,) that is 1 and 0 where told (1 wins) and smooth between: soft constraints round off the transitions."""
    hold = 3.0 * (ones | zeros)
    field = Factor(laplacian + sparse.diags_array(hold + 1e-7)).solve(hold * ones)
    # one more step of diffusion takes the crease out of the constraints' rim
    return np.clip(smoother.solve(field), 0, 1)
