"""Runs the benchmarks: `python tests/bench/run.py [NAME ...]`; results go to results/bench/<name>.json.

A benchmark is a module of this folder with `run(out_path: Path) -> None` that measures ours and the peer (where
there is one) in turn, in its own process, and writes its figures with `write`. Without names all run, one after the other.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import importlib.util
import json
import os
import platform
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

# set before numpy is imported anywhere: one thread, so that CPU-seconds are comparable between programs
THREADS = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
PACKAGES = (
    "headcap",
    "numpy",
    "scipy",
    "numba",
    "opencv-contrib-python-headless",
    "open3d",
    "trimesh",
    "pycolmap",
    "libigl",
    "scikit-learn",
)
HERE = Path(__file__).resolve().parent


def names() -> list[str]:
    """Benchmarks found in this folder."""
    return sorted(path.stem for path in HERE.glob("*.py") if path.stem != "run" and not path.stem.startswith("_"))


def measure(call: Callable[[], object], *, repeats: int = 1) -> dict[str, float]:
    """Seconds and CPU-seconds of one call, the best of `repeats`; CPU-seconds include child processes."""
    best: dict[str, float] = {}
    for _ in range(repeats):
        wall, cpu = time.perf_counter(), _cpu_seconds()
        call()
        took = {"seconds": time.perf_counter() - wall, "cpu_seconds": _cpu_seconds() - cpu}
        best = min(best or took, took, key=lambda entry: entry["cpu_seconds"])
    return best


def peak_memory_gib() -> float:
    """Peak resident size of this process or its largest child so far."""
    return max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)) / 2**20


def write(
    out_path: Path, *, ours: dict, peer: dict | None = None, figures: dict | None = None, memory_gib: float | None = None
) -> dict:
    """Write one benchmark: what both took, their ratio (peer over ours), peak memory and versions.

    `ours` and `peer` are what `measure` gave, with `name` and any figures of their own; without a peer there is no ratio.
    `memory_gib` replaces the peak of this process and its children.
    """
    compared = {"cpu_ratio": "cpu_seconds", "seconds_ratio": "seconds"}
    against = {"peer": peer} | {ratio: peer[key] / ours[key] for ratio, key in compared.items()} if peer else {}
    document = {
        "schema": "headcap.bench/1",
        "ours": ours,
        **against,
        "peak_memory_gib": memory_gib or peak_memory_gib(),
        "figures": figures or {},
        "versions": versions(),
        "machine": {"python": platform.python_version(), "processor": platform.machine(), "cores": os.cpu_count()},
    }
    out_path.parent.mkdir(parents=True, exist_ok=True)
    temporary = out_path.with_suffix(".tmp")
    temporary.write_text(json.dumps(document, indent=1) + "\n")
    temporary.replace(out_path)
    return document


def versions() -> dict[str, str]:
    """Versions of the package and of what it is measured against, where installed."""
    found = {}
    for package in PACKAGES:
        try:
            found[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def _cpu_seconds() -> float:
    own, children = resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN)
    return own.ru_utime + own.ru_stime + children.ru_utime + children.ru_stime


def _run_one(name: str, out_path: Path) -> None:
    spec = importlib.util.spec_from_file_location(name, HERE / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.run(out_path)


def _summary(out_path: Path) -> str:
    document = json.loads(out_path.read_text())
    sides = {label: document[label] for label in ("ours", "peer") if label in document}
    took = [f"{side.get('name', label)} {side['cpu_seconds']:.2f} CPU-s" for label, side in sides.items()]
    if "cpu_ratio" in document:
        took.append(f"ratio {document['cpu_ratio']:.2f}")
    return f"{', '.join(took)}, peak {document['peak_memory_gib']:.2f} GiB -> {out_path}"


def main(arguments: list[str]) -> int:
    """Run the named benchmarks, each in a process of its own so that peak memory is its own; 1 where one failed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("only", nargs="*", metavar="NAME", help=f"of {', '.join(names()) or 'none yet'}; all by default")
    parser.add_argument("--results", type=Path, default=Path("results/bench"), help="folder of the results")
    parser.add_argument("--in-process", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args(arguments)
    unknown = sorted(set(given.only) - set(names()))
    if unknown:
        parser.error(f"no benchmark is called {', '.join(unknown)}; there are {', '.join(names())}")
    if given.in_process:
        _run_one(given.only[0], given.results / f"{given.only[0]}.json")
        return 0
    failed = []
    for name in given.only or names():
        print(f"bench {name} ...", flush=True)
        command = [sys.executable, __file__, name, "--results", str(given.results), "--in-process"]
        if subprocess.run(command, env=os.environ | THREADS, check=False).returncode:
            failed.append(name)
        else:
            print(f"bench {name}: {_summary(given.results / f'{name}.json')}", flush=True)
    if failed:
        print(f"failed: {', '.join(failed)}", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.path.insert(0, str(HERE))  # benchmarks import `measure` and `write` from here
    sys.exit(main(sys.argv[1:]))
