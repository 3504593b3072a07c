"""Algorithm 1 at the paper's size: 5 people, 12,000 speech frames each, 10 iterations, 20 blendshapes.

Frames are synthesised as they are read: at 13 thousand vertices they would fill 9.5 GB, and what is measured is the training. The
paper's three hours on a machine of its time are its own figure; the peer here is one exact decomposition of the frames' residuals
of one person, thinned to 1,200 frames, as many times as the training needs one.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from run import measure, peak_memory_gib, write

from headcap.heads import procedural_model
from headcap.neck import LarynxMap, SpeechSubject, SpeechTrainingSettings, build_chart, larynx_map, train_speech
from headcap.neck.larynx.base_shape import Throat, bare_base

PEOPLE, FRAMES, MODES, THINNED = 5, 12_000, 24, 1_200


class Spoken:
    """Frames (f, n, 3) of one person, made when they are read: larynx, smooth motion of the whole head, no noise."""

    def __init__(self, base: np.ndarray, modes: np.ndarray, larynx: LarynxMap, seed: int) -> None:
        rng = np.random.default_rng(seed)
        time_s = np.arange(FRAMES) / 60
        self.base, self.modes, self.larynx, self.shape = base.astype(np.float32), modes, larynx, (FRAMES, *base.shape)
        rates, phases = rng.uniform(2, 20, MODES), rng.uniform(0, 6.3, MODES)
        self.weights = (np.sin(np.outer(time_s, rates) + phases) * 0.8 ** np.arange(MODES)).astype(np.float32)
        self.tau = 0.006 * np.sin(4.4 * time_s + rng.uniform(0, 6.3)) + 0.003 * np.sin(14.5 * time_s)
        self.alpha = 1 - 12 * self.tau

    def __len__(self) -> int:
        return FRAMES

    def __getitem__(self, chosen) -> np.ndarray:
        meshes = (self.weights[chosen] @ self.modes).reshape(-1, *self.base.shape) + self.base
        meshes[:, self.larynx.vertices] += self.larynx.offset(self.tau[chosen], self.alpha[chosen]).values
        return meshes


def run(out_path: Path) -> None:
    """Train, and decompose the peer's matrix once."""
    model = procedural_model(1, MODES)
    empty = larynx_map(model, build_chart(model), np.array([0.0, 0.0, 1.0]))
    subjects, true = _subjects(model, empty)
    kept = {}

    def train() -> None:
        kept["result"] = train_speech(model, empty, subjects, SpeechTrainingSettings(), progress=_tell)

    ours, memory = measure(train), peak_memory_gib()
    thinned = subjects[0].meshes[np.arange(0, FRAMES, FRAMES // THINNED)] - subjects[0].neutral.astype(np.float32)
    peer = measure(lambda: np.linalg.svd(thinned.reshape(len(thinned), -1), full_matrices=False))
    result = kept["result"]
    fits = [np.corrcoef(result.fits[subject.name].tau_m, tau)[0, 1] for subject, tau in zip(subjects, true, strict=True)]
    write(
        out_path,
        ours=ours | {"name": f"Algorithm 1, {PEOPLE} people of {FRAMES} frames", "vertices": len(model.vertices)},
        peer=peer | {"name": f"one exact decomposition of {THINNED} frames of one person", "vertices": len(model.vertices)},
        figures={
            "ours_peak_memory_gib": memory,
            "least_larynx_correlation": float(min(fits)),
            "energy_share_left": result.energy[-1][1] / result.energy[0][1],
        },
    )


def _tell(step: str, energy: float) -> None:
    print(f"  {step}: {energy:.6g}", flush=True)


def _subjects(model, empty: LarynxMap) -> tuple[list[SpeechSubject], list[np.ndarray]]:
    modes = 2e-3 * _unit(np.asarray(model.expression_basis)).reshape(MODES, -1).astype(np.float32)
    columns, rows = np.meshgrid(*(np.arange(count) for count in empty.weights_m.shape[::-1]))
    u, v = 1e3 * np.moveaxis(empty.origin_m + empty.pitch_m * np.stack([columns, rows], -1), -1, 0)
    centre = 1e3 * empty.uv_m.mean(axis=0)
    bump = 5e-3 * np.exp(-0.5 * (((u - centre[0]) / 8) ** 2 + ((v - centre[1]) / 7) ** 2))
    people, true = [], []
    for seed in range(PEOPLE):
        base = np.array(model.vertices, float)
        base[empty.vertices] = bare_base(Throat.of(base, model.triangles, empty))
        larynx = empty.with_weights((0.8 + 0.1 * seed) * bump, np.array([0.0, -0.3, 0.95]))
        neutral = base.copy()
        neutral[empty.vertices] += larynx.offset(0.0).values
        spoken = Spoken(base, modes, larynx, seed)
        people.append(SpeechSubject(f"person {seed}", neutral, spoken))
        true.append(spoken.tau)
    return people, true


def _unit(basis: np.ndarray) -> np.ndarray:
    """Each blendshape with its largest displacement 1."""
    return basis / np.linalg.norm(basis, axis=2).max(axis=1)[:, None, None]
