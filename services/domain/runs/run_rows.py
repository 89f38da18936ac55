"""Runs that have not ended as rows: what their estimates read of them.

**Conventions.** Statements are kept: a list of fifty runs asks each of them once.
"""

import json
from collections.abc import Iterable, Sequence
from functools import cache, lru_cache
from typing import Any, NamedTuple

from sqlalchemy import Row, Select, String, cast, literal_column, select
from sqlalchemy.orm import Session

from services.domain.runs.time_left import LABELLING
from services.domain.sequences.chosen_recordings import recording_ids_of
from services.runtime.database.rows import KeptSelect, numbered, numbered_parameters, parameter, places_for
from services.runtime.jobs.claims import QUEUED, RUNNING
from services.runtime.orm import Job

MOST_OLDER = 50
MOST_READ = 1000  # arguments that are kept as read
COLUMNS = (Job.id, Job.owner_id, Job.kind, Job.queue, Job.priority, cast(Job.arguments, String))
IS_ALIVE_RUN = (Job.id == Job.root_id, Job.state.in_([QUEUED, RUNNING]))


class RunInputs(NamedTuple):
    """What a labelling is of: its recordings, its calibration, and whether it ends with labels."""

    recording_ids: tuple[str, ...]
    calibration_id: str | None
    makes_labels: bool


class AliveRow(NamedTuple):
    """A run that has not ended; `inputs` of a labelling alone."""

    id: str
    owner_id: str
    kind: str
    queue: str
    priority: int
    inputs: RunInputs | None


def alive_rows(session: Session, job_ids: Sequence[str]) -> list[AliveRow]:
    """Those of the jobs that are runs and have not ended."""
    session.flush()  # kept statements see what was written, not what is to be
    rows = _of_ids(places_for(len(job_ids))).rows(session, numbered(job_ids)) if job_ids else ()
    return [_alive_row(row) for row in rows]


def older_of_the_same(session: Session, runs: Iterable[AliveRow]) -> list[AliveRow]:
    """Alive labellings that the same owners asked for before the newest of these, which are done first."""
    owners = sorted({run.owner_id for run in runs})
    if not owners:
        return []
    newest = max(run.id for run in runs)
    older = _older(places_for(len(owners))).rows(session, {**numbered(owners), "newest": newest})
    return [_alive_row(row) for row in older]


@cache
def _of_ids(places: int) -> KeptSelect:
    return KeptSelect(_alive().where(Job.id.in_(numbered_parameters(places))))


@cache
def _older(places: int) -> KeptSelect:
    mine = (Job.owner_id.in_(numbered_parameters(places)), Job.kind == LABELLING, Job.id < parameter("newest"))
    return KeptSelect(_alive().where(*mine).order_by(Job.id.desc()).limit(literal_column(str(MOST_OLDER))))


def _alive() -> Select[*tuple[Any, ...]]:
    return select(*COLUMNS).where(*IS_ALIVE_RUN)


def _alive_row(row: Row[*tuple[Any, ...]]) -> AliveRow:
    id, owner_id, kind, queue, priority, arguments = row
    return AliveRow(id, owner_id, kind, queue, priority, _inputs(arguments) if kind == LABELLING else None)


@lru_cache(MOST_READ)
def _inputs(arguments: str) -> RunInputs:
    read = json.loads(arguments)
    return RunInputs(recording_ids_of(read), read.get("calibration_id"), "label" in read.get("stages", ["label"]))
