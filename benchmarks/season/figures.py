"""Figures of a season: costs and outcome, read from the rows of its jobs at its end."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from sqlalchemy import func, select

from benchmarks.season.people import Season
from services.runtime.jobs.specs import JobSpec
from services.runtime.orm import Job, JobAttempt
from services.runtime.platform import Platform

OPENING = "eval.open"
QUEUE = JobSpec(OPENING).queue


@dataclass(frozen=True)
class Figures:
    """`cpu_s` by kind of job; `waited_s` from finalised to started, of every submission; `changed_past` must be 0."""

    lasted_s: float
    states: Mapping[str, int]
    jobs: Mapping[str, int]
    cpu_s: Mapping[str, float]
    waited_s: Sequence[float]
    alarms: Mapping[str, int]
    grants: int = 0
    moves: Sequence[Mapping[str, Any]] = field(default_factory=tuple)
    recomputed: str = ""
    changed_past: int = 0
    ties: str = ""

    @property
    def submissions(self) -> int:
        return sum(self.states.values())


def figures_of(platform: Platform, season: Season, lasted_s: float) -> Figures:
    with platform.database.reading() as session:
        spent = (
            select(Job.kind, func.count(), func.sum(JobAttempt.cpu_s))
            .join(JobAttempt, JobAttempt.job_id == Job.id)
            .where(Job.queue == QUEUE)
            .group_by(Job.kind)
        )
        rows = session.execute(spent).all()
        opened = select(Job.created_ns, Job.started_ns).where(Job.kind == OPENING)
        waited_s = [(begun - made) / 1e9 for made, begun in session.execute(opened) if begun]
    alarms = Counter(alarm["kind"] for alarm in season.admin.pages(f"/admin/phases/{season.phase_id}/alarms"))
    return Figures(
        lasted_s,
        Counter(season.states().values()),
        {kind: count for kind, count, _ in rows},
        {kind: cpu_s or 0.0 for kind, _, cpu_s in rows},
        waited_s,
        alarms,
    )


def show(figures: Figures) -> None:
    table = Table("what", "figure", title=f"{figures.submissions} submissions in {figures.lasted_s:.0f} s")
    for what, figure in _rows(figures):
        table.add_row(what, figure)
    Console(width=110).print(table)


def _rows(figures: Figures) -> list[tuple[str, str]]:
    waited = np.quantile(figures.waited_s, (0.5, 0.95, 1.0))
    kinds = ", ".join(f"{kind} {cpu / figures.jobs[kind]:.3f} s" for kind, cpu in sorted(figures.cpu_s.items()))
    ends = ", ".join(f"{count} {state}" for state, count in sorted(figures.states.items()))
    return [
        ("submissions a minute", f"{60 * figures.submissions / figures.lasted_s:.1f}"),
        ("how they ended", ends),
        ("CPU a submission, re-scores included", f"{sum(figures.cpu_s.values()) / figures.submissions:.2f} s"),
        ("CPU a job", kinds),
        ("jobs", ", ".join(f"{kind} {count}" for kind, count in sorted(figures.jobs.items()))),
        ("wait for the start, median / 95 % / maximum", " / ".join(f"{value:.1f} s" for value in waited)),
        ("scorings granted", str(figures.grants)),
        ("alarms", ", ".join(f"{count} {kind}" for kind, count in sorted(figures.alarms.items())) or "none"),
        *(("re-score", _moved(value)) for value in figures.moves),
        ("board from the kept counts", figures.recomputed),
        ("boards of the past that changed", str(figures.changed_past)),
        ("ties of the last board", figures.ties),
    ]


def _moved(diff: Mapping[str, Any]) -> str:
    order = "order changed" if diff["is_order_changed"] else "same order"
    leader = ", new leader" if diff["is_new_leader"] else ""
    largest = f"at most {diff['largest_rank_move']} ranks, {diff['largest_value_move']:.4f} mIoU"
    return f"{len(diff['rows'])} rows, {order}{leader}, {largest}"
