"""What a run is doing, told in one line at a time: stage, chunk, time left.

Snakemake's own output is the source: it is followed line by line, so that a run on a cluster is told like a local one.
"""

from __future__ import annotations

import re
import time
from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field

_RULE = re.compile(r"^(?:local)?(?:rule|checkpoint) (\w+):$")
_FIELD = re.compile(r"^ {4}(jobid|wildcards): (.*)$")
_FINISHED = re.compile(r"^Finished jobid: (\d+) \(Rule: (\w+)\)")
_STEPS = re.compile(r"^(\d+) of (\d+) steps \(")
_COUNT = re.compile(r"^(\w+) +(\d+)$")

USUAL_S = {
    "rehearse": 400.0,
    "calibrate": 12.0,
    "register": 25.0,
    "reconstruct": 80.0,
    "track_start": 25.0,
    "track_anchors": 150.0,
    "track": 80.0,
    "train_expressions": 60.0,
    "train_neck": 40.0,
    "fit_neck": 10.0,
    "train_speech": 12.0,
    "evaluate": 40.0,
    "report": 15.0,
}
"""What a job of a stage usually takes; only the proportions count."""
OTHER_S = 5.0


@dataclass
class Progress:
    """Follows Snakemake's output; `follow` returns the line to show for a line of output, or None."""

    clock: Callable[[], float] = time.monotonic
    _counts: Counter = field(default_factory=Counter)
    _finished: Counter = field(default_factory=Counter)
    _durations: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    _started: dict[str, float] = field(default_factory=dict)
    _names: dict[str, str] = field(default_factory=dict)
    _rule: str = ""
    _jobid: str = ""
    _counting: bool = False
    _total: int = 0
    _done: int = 0
    _began: float | None = None

    def follow(self, line: str) -> str | None:
        """Take in one line of output."""
        line = line.rstrip("\n")
        if self._began is None:
            self._began = self.clock()
        if line.startswith("headcap: "):
            return line.removeprefix("headcap: ")
        if line == "Job stats:":
            self._counting, self._counts = True, Counter()
        elif self._counting:
            self._count(line)
        elif match := _RULE.match(line):
            self._rule, self._jobid = match[1], ""
        elif match := _FIELD.match(line):
            return self._describe(match[1], match[2])
        elif match := _FINISHED.match(line):
            self._finish(match[1], match[2])
        elif match := _STEPS.match(line):
            self._done, self._total = int(match[1]), int(match[2])
            return f"[{self._done}/{self._total}] {self.time_left()}"
        return None

    def time_left(self) -> str:
        """How much longer: stages that were met take as long as they took, others in proportion to what is usual."""
        spent = sum(sum(durations) for durations in self._durations.values())
        if not spent or not self._total:
            return "time left is not known yet"
        usual = sum(USUAL_S.get(rule, OTHER_S) * len(durations) for rule, durations in self._durations.items())
        known = self._counts - self._finished
        work = sum(count * self._job_s(rule, spent / usual) for rule, count in known.items())
        # jobs that came to be known while running are chunks of frames
        unknown = max(0, self._total - self._done - sum(known.values()))
        work += unknown * self._job_s("reconstruct", spent / usual)
        # jobs run side by side: as many seconds of jobs passed in a second as so far
        left = _spoken(work * (self.clock() - self._began) / spent)
        open_ended = "evaluate" in known and not unknown and not {"reconstruct", "track"} & {*self._counts, *self._finished}
        return f"at least {left} left" if open_ended else f"about {left} left"

    def _job_s(self, rule: str, pace: float) -> float:
        met = self._durations.get(rule)
        return sum(met) / len(met) if met else pace * USUAL_S.get(rule, OTHER_S)

    def _count(self, line: str) -> None:
        if match := _COUNT.match(line):
            if match[1] == "total":
                self._counting, self._total = False, int(match[2])
            else:
                self._counts[match[1]] = int(match[2])

    def _describe(self, key: str, value: str) -> str | None:
        if key == "jobid":
            self._jobid = value
            self._started[value] = self.clock()
            self._names[value] = self._rule
            return None
        what = ", ".join(part.split("=", 1)[-1] for part in value.split(", "))
        self._names[self._jobid] = f"{self._rule} {what}"
        return self._names[self._jobid]

    def _finish(self, jobid: str, rule: str) -> None:
        self._finished[rule] += 1
        if jobid in self._started:
            self._durations[rule].append(self.clock() - self._started.pop(jobid))


def _spoken(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest:02d} s" if minutes else f"{rest} s"
