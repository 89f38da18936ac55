"""The durations of jobs by kind over days, at `/admin/durations`."""

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime, tzinfo
from typing import Annotated

import numpy as np
from fastapi import APIRouter, Query, Request
from fastapi.responses import HTMLResponse
from sqlalchemy import select

from api.deps import Administrator, PlatformDep
from services.runtime.orm import Job
from services.runtime.orm.base import now_ns
from web.rendering import page
from web.zones import zone_of

router = APIRouter()
DAY_NS = 86_400 * 10**9
MOST_READ = 100_000
DAYS = (1, 7, 30, 90)
ENDS = ("succeeded", "failed")


@dataclass(frozen=True)
class KindDurations:
    """The ended jobs of a kind: their number, the failed ones, and the durations of those that succeeded.

    `daily` is the median of each day with its number of jobs, oldest first; days without any are left out.
    """

    kind: str
    ended: int
    failed: int
    median_s: float | None
    p90_s: float | None
    longest_s: float | None
    daily: tuple[tuple[str, float, int], ...]


@router.get("/admin/durations")
def durations(
    request: Request,
    caller: Administrator,
    platform: PlatformDep,
    days: Annotated[int, Query(ge=1, le=90)] = 7,
) -> HTMLResponse:
    """Show the newest `MOST_READ` jobs that ended in these days, runs and the jobs within them."""
    ended = select(Job.kind, Job.state, Job.started_ns, Job.finished_ns)
    ended = ended.where(Job.finished_ns >= now_ns() - days * DAY_NS, Job.state.in_(ENDS), Job.started_ns.is_not(None))
    with platform.database.reading() as session:
        rows = session.execute(ended.order_by(Job.finished_ns.desc()).limit(MOST_READ)).all()
    ended_jobs = (
        (kind, state, start, end) for kind, state, start, end in rows if start is not None and end is not None
    )
    kinds = durations_of(ended_jobs, zone_of(request))
    is_cut = len(rows) == MOST_READ
    return page(request, caller, "admin/durations.html", kinds=kinds, days=days, choices=DAYS, is_cut=is_cut)


def durations_of(jobs: Iterable[tuple[str, str, int, int]], zone: tzinfo = UTC) -> tuple[KindDurations, ...]:
    """Return durations by kind, from (kind, state, started_ns, finished_ns); the kind with the longest total first."""
    taken, failed = defaultdict[str, list[tuple[int, float]]](list), defaultdict[str, int](int)
    for kind, state, started_ns, finished_ns in jobs:
        if state == "succeeded":
            taken[kind].append((finished_ns, max(0, finished_ns - started_ns) / 1e9))
        else:
            failed[kind] += 1
    total_s = {kind: sum(duration_s for _, duration_s in taken[kind]) for kind in {*taken, *failed}}
    return tuple(_of_kind(kind, taken[kind], failed[kind], zone) for kind in sorted(total_s, key=total_s.__getitem__))[
        ::-1
    ]


def _of_kind(kind: str, taken: list[tuple[int, float]], failed: int, zone: tzinfo) -> KindDurations:
    if not taken:
        return KindDurations(kind, failed, failed, None, None, None, ())
    took_s = np.array([duration_s for _, duration_s in taken])
    by_day = defaultdict[str, list[float]](list)
    for finished_ns, duration_s in taken:
        by_day[datetime.fromtimestamp(finished_ns / 1e9, zone).strftime("%Y-%m-%d")].append(duration_s)
    daily = tuple((day, float(np.median(by_day[day])), len(by_day[day])) for day in sorted(by_day))
    median_s, p90_s = (float(value) for value in np.percentile(took_s, (50, 90)))
    return KindDurations(kind, len(taken) + failed, failed, median_s, p90_s, float(took_s.max()), daily)
