"""A tracked take as plain arrays, named as FLAME's tools name theirs."""

from pathlib import Path

import numpy as np

from headcap.artifacts import atomic_path
from headcap.registration.sequence import MeshSequence
from headcap.registration.template import Template


def write_npz(path: Path | str, template: Template, sequence: MeshSequence) -> None:
    """Write `v_template` (n, 3), `f` (m, 3), `vt` (k, 2; v counted upwards), `ft` (m, 3), `verts` (t, n, 3) and `time_s` (t,).

    Metres, float32; a file any numpy opens without pickle.
    """
    positions = sequence.positions()
    if positions.shape[1:] != template.vertices.shape:
        raise ValueError(f"frames {positions.shape[1:]} do not fit the template's {template.vertices.shape}")
    arrays = {
        "v_template": template.vertices.astype(np.float32),
        "f": template.triangles.astype(np.int32),
        "vt": (template.uv * [1.0, -1.0] + [0.0, 1.0]).astype(np.float32),
        "ft": template.uv_triangles.astype(np.int32),
        "verts": positions,
        "time_s": np.asarray(sequence.time_s, np.float64),
    }
    with atomic_path(path) as temporary, open(temporary, "wb") as handle:
        np.savez(handle, **arrays)
