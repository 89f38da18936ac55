"""The cost of a label set: seconds by stage, processor time and memory."""

from dataclasses import dataclass, field
from typing import Any

from services.labeler.workers import TaskResult


@dataclass
class CostMeter:
    """Takes down every task that is done; stages overlap, so each is given the time its tasks took, added up."""

    busy_s: dict[str, float] = field(default_factory=dict)
    cpu_s: dict[int, float] = field(default_factory=dict)
    peak_bytes: dict[int, int] = field(default_factory=dict)

    def note(self, stage: str, done: TaskResult[Any]) -> None:
        """Seconds are not given for a stage called ""."""
        if stage:
            self.busy_s[stage] = self.busy_s.get(stage, 0.0) + done.busy_s
        self.cpu_s[done.pid] = max(done.cpu_s, self.cpu_s.get(done.pid, 0.0))
        self.peak_bytes[done.pid] = max(done.peak_bytes, self.peak_bytes.get(done.pid, 0))

    def as_record(self) -> dict[str, Any]:
        return {
            "stages_busy_s": {stage: round(busy, 3) for stage, busy in self.busy_s.items()},
            "cpu_s": round(sum(self.cpu_s.values()), 3),
            "peak_bytes": {
                "largest_process": max(self.peak_bytes.values()),
                "all_processes": sum(self.peak_bytes.values()),
            },
        }
