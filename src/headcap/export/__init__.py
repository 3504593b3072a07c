"""Results in the files of other programs: OBJ, GLB, PC2 point caches, npz arrays; expression bases also as USD."""

from headcap.export.arrays import write_npz
from headcap.export.expressions import write_basis
from headcap.export.gltf import write_glb
from headcap.export.obj import write_obj
from headcap.export.pc2 import write_pc2
from headcap.registration.point_cache import PointCache, read_pc2

__all__ = ["PointCache", "read_pc2", "write_basis", "write_glb", "write_npz", "write_obj", "write_pc2"]
