"""Real people: what `headcap lips` makes of the seven clips of the GRID corpus among the test data, at every frame.

    python tests/bench/talking_faces.py LIPS.NPZ [CLIP ...]

With a study's kit it prints the table; started by `run.py` it takes the demo's, and says so where there is none. Words and their
times (`talking_faces_words`) were read off spectrograms of the sound, bursts to 0.01 s, without looking at the pictures: a
stop begins where the sound before it ends, one at the very start 0.06 s before its burst.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from run import write

from headcap.evaluation.lip_clip import LipClip
from headcap.evaluation.lip_clips import clip_figures, closure_totals
from headcap.evaluation.metrics import describe
from headcap.workflow.lips import correct_videos, lip_requests

HERE = Path(__file__).resolve().parent
KIT = HERE.parents[1] / "results/demo/train_lips/lips.npz"
CLIPS = ("bbaf2n", "brbk7n", "lbax4n", "lbbc2a", "lwbsza", "sbwe5n", "swiz3n")


def run(out_path: Path, kit: Path = KIT, names: tuple[str, ...] = CLIPS, folder: Path | None = None) -> None:
    """Measure, print and write; the page and its videos stay in `folder` where one is given."""
    data = Path(os.environ.get("HEADCAP_TEST_DATA", HERE.parents[2] / "shared/data")) / "talking_faces"
    missing = [path for path in (kit, data) if not path.exists()]
    if missing:
        write(out_path, ours={"name": f"skipped, for there is no {missing[0]}:", "seconds": 0.0, "cpu_seconds": 0.0})
        return
    with tempfile.TemporaryDirectory() as temporary:
        out = folder or Path(temporary)
        videos = [data / f"{name}.mpg" for name in names]
        words = [HERE / "talking_faces_words" / f"{name}.align" for name in names]
        start, cpu = time.perf_counter(), time.process_time()
        answer = correct_videos(lip_requests(videos, kit, words=words), out)
        took = {"seconds": time.perf_counter() - start, "cpu_seconds": time.process_time() - cpu}
        clips = [LipClip.load(out / name / "clip.npz") for name in names if name not in answer.failures]
    figures = clip_figures(clips)
    for figure in figures:
        print(describe(figure))
    totals = closure_totals(clips)
    for total in totals:
        print(
            f"{total.method}: {total.shown} of {total.closures} closures shown, {total.expected:.1f} by chance "
            f"(p {total.chance:.2g}); mean rank {total.mean_rank:.2f} (p {total.rank_chance:.2g})"
        )
    named = {f"{figure.session}.{figure.name}": figure.value for figure in figures}
    of_all = {f"{total.method}.{name}": getattr(total, name) for total in totals for name in ("shown", "closures", "expected")}
    write(out_path, ours={"name": "headcap lips", **took}, figures=named | of_all | {"failed": sorted(answer.failures)})


if __name__ == "__main__":
    kept = Path("results/bench/talking_faces")
    run(kept.with_suffix(".json"), Path(sys.argv[1]) if len(sys.argv) > 1 else KIT, tuple(sys.argv[2:]) or CLIPS, kept)
