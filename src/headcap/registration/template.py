"""The subject in the model's topology: what register hands to track."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import load_arrays, save_arrays
from headcap.geometry.transforms import transform

KIND, SCHEMA = "template", 1


@dataclass(frozen=True)
class Template:
    """A textured mesh in the model's topology.

    Texture coordinates are per corner, u right and v down, in [0, 1]; texel (0, 0)'s centre lies at (0.5/width, 0.5/height).
    """

    vertices: NDArray[np.float64]
    """(n, 3) metres, in the rig's world frame once registered to a take, else in the scan's upright frame."""
    triangles: NDArray[np.int32]
    """(m, 3), counter-clockwise seen from outside."""
    uv: NDArray[np.float64]
    """(k, 2) texture coordinates."""
    uv_triangles: NDArray[np.int32]
    """(m, 3) indices into uv, corner by corner as `triangles`."""
    regions: dict[str, NDArray[np.bool_]] = field(default_factory=dict)
    """Named vertex masks (n,): face, neck, scalp, ears, eyes, lips_upper, lips_lower, lips_inner_upper, lips_inner_lower,
    mouth_interior."""
    landmarks: dict[str, int] = field(default_factory=dict)
    """Named vertices."""
    texture: NDArray[np.uint8] | None = None
    """(height, width, 3) RGB."""
    texture_known: NDArray[np.bool_] | None = None
    """(height, width) true where a recording or the scan coloured the texel."""

    def __post_init__(self) -> None:
        if self.uv_triangles.shape != self.triangles.shape:
            raise ValueError(f"uv_triangles {self.uv_triangles.shape} must match triangles {self.triangles.shape}")
        for name, mask in self.regions.items():
            if mask.shape != (len(self.vertices),):
                raise ValueError(f"region {name} has {mask.shape}, expected ({len(self.vertices)},)")

    def with_vertices(self, vertices: NDArray) -> Template:
        """The same surface with other positions (n, 3)."""
        return replace(self, vertices=np.asarray(vertices, np.float64))

    def transformed(self, target_from_source: NDArray) -> Template:
        """The same surface in another frame, by a rigid transform (4, 4)."""
        return self.with_vertices(transform(target_from_source, self.vertices))

    def part(self, chosen: NDArray[np.bool_]) -> tuple[Template, NDArray[np.int64], NDArray[np.bool_]]:
        """The triangles whose corners are all chosen (n,): as a template, its vertices' indices (k,), its triangles (m,)."""
        inside = chosen[self.triangles].all(axis=1)
        kept = np.unique(self.triangles[inside])
        number = np.full(len(self.vertices), -1, np.int32)
        number[kept] = np.arange(len(kept))
        part = replace(
            self,
            vertices=self.vertices[kept],
            triangles=number[self.triangles[inside]],
            uv_triangles=self.uv_triangles[inside],
            regions={name: mask[kept] for name, mask in self.regions.items()},
            landmarks={name: int(number[v]) for name, v in self.landmarks.items() if number[v] >= 0},
        )
        return part, kept, inside

    def with_texture(self, texture: NDArray[np.uint8], known: NDArray[np.bool_]) -> Template:
        """The same surface with another texture (height, width, 3)."""
        return replace(self, texture=texture, texture_known=known)

    def save(self, path: Path | str) -> None:
        """Write as npz artifact `headcap.template/1`."""
        arrays = {"vertices": self.vertices, "triangles": self.triangles, "uv": self.uv, "uv_triangles": self.uv_triangles}
        if self.texture is not None:
            arrays |= {"texture": self.texture, "texture_known": self.texture_known}
        arrays |= {f"region/{name}": mask for name, mask in self.regions.items()}
        save_arrays(path, KIND, SCHEMA, arrays, {"landmarks": self.landmarks})

    @classmethod
    def load(cls, path: Path | str) -> Template:
        """Read what `save` wrote; raises `ArtifactError`."""
        arrays, meta = load_arrays(path, KIND, SCHEMA)
        regions = {name.removeprefix("region/"): arrays.pop(name) for name in list(arrays) if name.startswith("region/")}
        return cls(**arrays, regions=regions, landmarks=meta["landmarks"])
