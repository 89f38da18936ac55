"""The measured queries: lists and boards of the API, claims, the sweeper and the garbage collector.

**Conventions.** A query uses the route or the function of production; changes are rolled back. `who` is the caller: the
administrator, a user with a fifth of all sequences (`rich`), with five (`modest`), a visitor.
"""

from collections.abc import Callable
from dataclasses import dataclass
from hashlib import md5
from random import Random

import httpx
from sqlalchemy import select

from api.views.admin import running_items, worker_items
from benchmarks.rows import boards, kinds
from benchmarks.rows.bulk_inserts import hex_id
from services.domain.benchmarks.boards.board import board_order
from services.domain.benchmarks.boards.entries import BoardQuery
from services.domain.benchmarks.boards.history import history, tracks_with_rows
from services.domain.benchmarks.phases.evaluation_versions import EvaluationVersion
from services.domain.benchmarks.submissions.completion_estimate import expected_s
from services.domain.benchmarks.submissions.sweeper_chores import settle_ended, tidy_submissions
from services.domain.runs.estimates import time_left
from services.runtime.access import roles, storage_quota, tokens
from services.runtime.jobs.claims import claim, wake_ups_wanted
from services.runtime.jobs.lease_sweep import Sweeper
from services.runtime.orm import Blob, Job, LooseObject, Phase, SubmissionRow, User
from services.runtime.platform import Platform
from services.runtime.uploads import expire
from testing.api.serving import Person


@dataclass(frozen=True)
class Kit:
    """The callers and objects of queries; `amounts` are the inserted rows."""

    platform: Platform
    client: httpx.Client
    people: dict[str, Person]
    amounts: kinds.Amounts


@dataclass(frozen=True)
class Question:
    """A query; `bound` is the reason if the answer itself grows with the rows, in which case it need not be quick."""

    name: str
    ask: Callable[[Kit, Random], object]
    bound: str = ""


def people_of(platform: Platform) -> dict[str, Person]:
    """Return tokens for some of the inserted users."""
    people = {}
    with platform.database.transaction() as session:
        for name, number in (("administrator", 0), ("rich", 1), ("modest", 2), ("many", 4)):
            user = session.scalars(select(User).where(User.name == f"person-{number}")).one()
            secret = tokens.issue(session, user, "benchmark", roles.SCOPES_OF[user.role], 86400.0)
            people[name] = Person(user.id, user.name, secret)
    return people


def questions() -> tuple[Question, ...]:
    return (*_lists(), *_singles(), *_of_boards(), *_of_workers())


def _route(name: str, who: str, path: str, bound: str = "") -> Question:
    """Return a GET of a path in which placeholders such as `{sequence}` stand for a row's id, another one each time."""

    def ask(kit: Kit, chance: Random) -> None:
        number = chance.randrange(1, kit.amounts.sequences - kit.amounts.backlog - 1000)
        of_run = kit.amounts.jobs_each + 1
        ids = {"sequence": (kinds.SEQUENCE, number), "run": (kinds.JOB, number * of_run), "phase": (boards.PHASE, 3)}
        filled = {key: hex_id(*value) for key, value in ids.items()}
        filled |= {"modest": kit.people["modest"].user_id, "token": md5(f"frame{number}:0".encode()).hexdigest()}
        headers = kit.people[who].headers if who in kit.people else {}
        reply = kit.client.get(f"/api/v1{path.format(**filled)}", headers=headers)
        if reply.status_code != httpx.codes.OK:
            raise RuntimeError(f"{name}: {reply.status_code} {reply.text[:500]}")

    return Question(name, ask, bound)


def _lists() -> tuple[Question, ...]:
    all_of = "a count of all rows"
    return (
        _route("sequences, all", "administrator", "/sequences"),
        _route("sequences, of a rare region", "administrator", "/sequences?region=islet"),
        _route("sequences, of an environment", "administrator", "/sequences?environment=desert"),
        _route("sequences, by the start of a name", "administrator", "/sequences?name=run-999"),
        _route("sequences, of one owner", "administrator", "/sequences?owner_id={modest}"),
        _route("sequences, own and public, of a fifth", "rich", "/sequences"),
        _route("sequences, own and public, of five", "modest", "/sequences"),
        _route("sequences, of a visitor", "", "/sequences"),
        _route("runs of an owner of many", "rich", "/jobs"),
        _route("runs of an owner of five", "modest", "/jobs"),
        _route("failed runs of an owner of five", "modest", "/jobs?state=failed"),
        _route("jobs, all", "administrator", "/admin/jobs"),
        _route("jobs that failed", "administrator", "/admin/jobs?state=failed"),
        _route("jobs that run", "administrator", "/admin/jobs?state=running"),
        _route("jobs, dead", "administrator", "/admin/jobs?dead=true"),
        _route("jobs of a queue", "administrator", "/admin/jobs?queue=labeler"),
        _route("jobs of a kind without jobs", "administrator", "/admin/jobs?kind=labeler.export"),
        _route("jobs of an owner", "administrator", "/admin/jobs?owner=person-2"),
        _route("counts of jobs by state", "administrator", "/admin/jobs/counts", all_of),
        _route("queues", "administrator", "/admin/queues", "counts of queued and of recently ended jobs"),
        _route("audit log of a rare act", "administrator", "/admin/audit-log?act=token.revoke"),
        _route("audit log of one person", "administrator", "/admin/audit-log?actor=person-2"),
        _route("audit log of one object", "administrator", "/admin/audit-log?subject_id={sequence}"),
        _route("submissions, all", "administrator", "/submissions"),
        _route("submissions of the caller's teams", "many", "/submissions"),
        _route("submissions of a phase", "administrator", "/submissions?phase_id={phase}&state=failed"),
        _route("users", "administrator", "/admin/users"),
        _route("teams", "administrator", "/teams"),
        _route("composition of a platform", "administrator", "/statistics", "a sum over all sequences"),
    )


def _singles() -> tuple[Question, ...]:
    return (
        _route("one sequence", "administrator", "/sequences/{sequence}"),
        _route("its recordings", "administrator", "/sequences/{sequence}/recordings"),
        _route("its exports", "administrator", "/sequences/{sequence}/exports"),
        _route("one run", "administrator", "/admin/jobs/{run}"),
        Question("the time left of fifty runs", _time_left),
        _route("one frame by its token", "administrator", "/frames/{token}"),
        Question("stored bytes of an owner of a fifth", _balance, "a sum over one owner's uploads"),
    )


def _time_left(kit: Kit, _chance: Random) -> None:
    alive = select(Job.id).where(Job.state == "queued", Job.id == Job.root_id).order_by(Job.id.desc()).limit(50)
    with kit.platform.database.reading() as session:
        time_left(session, session.scalars(alive).all())


def _balance(kit: Kit, _chance: Random) -> None:
    with kit.platform.database.reading() as session:
        storage_quota.balance(session, kit.people["rich"].user_id)


def _of_boards() -> tuple[Question, ...]:
    whole = "every entry of the board is read and sorted"
    return (
        Question("a board of some thousand entries", lambda kit, _: _board(kit, 3), whole),
        Question("a board of half of all entries", lambda kit, _: _board(kit, 0), whole),
        Question("when a board changed", lambda kit, _: _history(kit, 3), whole),
        Question("when a waiting submission will be scored", _expected),
        _route("what a phase is", "administrator", "/phases/{phase}"),
    )


def _board(kit: Kit, number: int) -> None:
    with kit.platform.database.reading() as session:
        phase = session.get_one(Phase, hex_id(boards.PHASE, number))
        board_order(session, phase, EvaluationVersion(hex_id(boards.TRUTH, number), boards.METRIC), BoardQuery())


def _history(kit: Kit, number: int) -> None:
    with kit.platform.database.reading() as session:
        phase = session.get_one(Phase, hex_id(boards.PHASE, number))
        history(session, phase)
        tracks_with_rows(session, phase)


def _expected(kit: Kit, _chance: Random) -> None:
    with kit.platform.database.reading() as session:
        row = session.get_one(SubmissionRow, hex_id(boards.SUBMISSION, kit.amounts.submissions))
        expected_s(session, row)


def _of_workers() -> tuple[Question, ...]:
    return (
        Question("claim of an ingest job", lambda kit, _: _claim(kit, "ingest")),
        Question("claim without a ready job", lambda kit, _: _claim(kit, "eval")),
        Question("wake-ups wanted", _wake_ups, "a count of queued jobs, at most 10,000"),
        Question("attempts without heartbeats", _recover, "all that run"),
        Question("workers and what they hold", _workers, "all that run"),
        Question("submissions whose run ended", lambda kit, _: settle_ended(kit.platform)),
        Question("submissions to be tidied", lambda kit, _: tidy_submissions(kit.platform)),
        Question("uploads to be expired", lambda kit, _: expire(kit.platform)),
        Question("the collector's query of listed objects", _known),
    )


def _claim(kit: Kit, queue: str) -> None:
    with kit.platform.database.transaction() as session:
        claim(session, queue)
        session.rollback()


def _wake_ups(kit: Kit, _chance: Random) -> None:
    with kit.platform.database.reading() as session:
        wake_ups_wanted(session, "ingest")


def _recover(kit: Kit, _chance: Random) -> None:
    Sweeper(kit.platform, lambda _queue: 0, lambda _queue, _times: None).recover()


def _workers(kit: Kit, _chance: Random) -> None:
    with kit.platform.database.reading() as session:
        worker_items(session, kit.platform.settings)
        running_items(session)


def _known(kit: Kit, chance: Random) -> None:
    keys = [f"blobs/{chance.randrange(256):02x}/{chance.randbytes(32).hex()}.0a1b2c3d" for _ in range(500)]
    with kit.platform.database.reading() as session:
        session.scalars(select(LooseObject.object_key).where(LooseObject.object_key.in_(keys))).all()
        session.scalars(select(Blob.object_key).where(Blob.object_key.in_(keys))).all()
