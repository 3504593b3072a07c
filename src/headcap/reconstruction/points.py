"""One frame's fused points as a PLY file other tools can open."""

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import ArtifactError, atomic_path

SCHEMA = "headcap.point_cloud/1"
_VERTEX = np.dtype(
    [(name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz", "confidence")]
    + [(name, "u1") for name in ("red", "green", "blue")]
)


@dataclass(frozen=True)
class PointCloud:
    """Points on the subject's surface at one moment, in the rig's world frame."""

    positions: NDArray[np.float32]
    """(n, 3) metres."""
    normals: NDArray[np.float32]
    """(n, 3) unit, pointing out of the surface."""
    confidence: NDArray[np.float32]
    """(n,) 0 to 1."""
    colours: NDArray[np.uint8]
    """(n, 3) RGB."""
    time_s: float
    """Moment on the take's common clock."""

    def __len__(self) -> int:
        return len(self.positions)

    def save(self, path: Path | str) -> None:
        """Write a binary PLY with the artifact's kind in a comment."""
        vertices = np.empty(len(self), _VERTEX)
        for block, names in ((self.positions, ("x", "y", "z")), (self.normals, ("nx", "ny", "nz"))):
            for axis, name in enumerate(names):
                vertices[name] = block[:, axis]
        vertices["confidence"] = self.confidence
        for axis, name in enumerate(("red", "green", "blue")):
            vertices[name] = self.colours[:, axis]
        properties = [f"property {'uchar' if _VERTEX[name] == np.uint8 else 'float'} {name}" for name in _VERTEX.names]
        header = [
            "ply",
            "format binary_little_endian 1.0",
            f"comment {SCHEMA}",
            f"comment time_s {float(self.time_s)!r}",
            f"element vertex {len(self)}",
            *properties,
            "end_header\n",
        ]
        with atomic_path(path) as temporary:
            temporary.write_bytes("\n".join(header).encode() + vertices.tobytes())

    @classmethod
    def load(cls, path: Path | str) -> "PointCloud":
        """Read what `save` wrote; raises `ArtifactError` for any other file."""
        stream = io.BytesIO(Path(path).read_bytes())
        lines = []
        while not lines or (lines[-1] and lines[-1] != "end_header"):
            lines.append(stream.readline().decode("ascii", "replace").rstrip("\n"))
        if f"comment {SCHEMA}" not in lines:
            raise ArtifactError(f"{path} is no {SCHEMA} file; run `reconstruct` again with this version")
        fields = dict(line.rsplit(" ", 1) for line in lines if line.startswith(("element vertex", "comment time_s")))
        vertices = np.frombuffer(stream.read(), _VERTEX)
        if len(vertices) != int(fields["element vertex"]):
            raise ArtifactError(f"{path} is cut short; delete it and run `reconstruct` again")
        stack = lambda *names: np.stack([vertices[name] for name in names], axis=1)  # noqa: E731
        return cls(
            positions=stack("x", "y", "z"),
            normals=stack("nx", "ny", "nz"),
            confidence=vertices["confidence"].copy(),
            colours=stack("red", "green", "blue"),
            time_s=float(fields["comment time_s"]),
        )
