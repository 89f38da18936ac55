"""The rows that `benchmarks.api` reads: sequences with their runs, of several owners, and the owners' tokens."""

from dataclasses import dataclass

from sqlalchemy.orm import Session

from services.runtime.access import roles, tokens, users
from services.runtime.database.transactions import Database
from services.runtime.orm import Job, SequenceRow, User, new_id

OWNERS = 8
SEQUENCES = 2000
JOBS_OF_A_SEQUENCE = 5
STATES = ("succeeded", "failed", "running", "queued")
ENDED = ("succeeded", "failed")


@dataclass(frozen=True)
class Reader:
    """A user with a token."""

    secret: str


def fill(database: Database, readers: int, states: tuple[str, ...] = STATES) -> list[Reader]:
    """Insert 2,000 sequences, each with a run of four jobs in these states; return `readers` tokens shared among the
    owners.

    If workers run, the states must be `ENDED`, because workers would process queued jobs.
    """
    with database.transaction() as session:
        owners = [users.create_user(session, f"owner-{number}", "curator") for number in range(OWNERS)]
        sequences = [_sequence(number, owners[number % OWNERS]) for number in range(SEQUENCES)]
        runs = [_run(sequence, states[number % len(states)]) for number, sequence in enumerate(sequences)]
        for rows in (sequences, runs, [job for run in runs for job in _jobs(run)]):
            session.add_all(rows)
            session.flush()
        return [_reader(session, owners[number % OWNERS], number) for number in range(readers)]


def _sequence(number: int, owner: User) -> SequenceRow:
    name = f"forest-{number}"
    return SequenceRow(id=new_id(), owner_id=owner.id, name=name, environment="forest", region="Gyeonggi")


def _run(sequence: SequenceRow, state: str) -> Job:
    run = Job(id=new_id(), owner_id=sequence.owner_id, sequence_id=sequence.id, kind="sequence.process")
    run.root_id, run.state = run.id, state
    return run


def _jobs(run: Job) -> list[Job]:
    shared = {"root_id": run.id, "owner_id": run.owner_id, "sequence_id": run.sequence_id, "state": run.state}
    return [Job(kind="labeler.surface", queue="labeler", **shared) for _ in range(JOBS_OF_A_SEQUENCE - 1)]


def _reader(session: Session, owner: User, number: int) -> Reader:
    return Reader(tokens.issue(session, owner, f"reader {number}", roles.SCOPES_OF["curator"], 86400.0))
