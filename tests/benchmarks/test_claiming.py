"""What `benchmarks.rows.claiming` reads from a log, and its forecast against closed forms."""

import pytest

from benchmarks.rows.claiming.forecast import JobDemand, WorkerFleet, carried, pace
from benchmarks.rows.claiming.server_log import transactions

LOG = """\
worker 11 LOG:  statement: BEGIN
worker 12 LOG:  statement: ;
api 13 LOG:  execute <unnamed>: SELECT 1
worker 11 LOG:  execute _pg3_1: UPDATE jobs SET heartbeats=(jobs.heartbeats + $1)
\tWHERE jobs.id = $2
worker 11 DETAIL:  Parameters: $1 = '1'
worker 12 LOG:  statement: BEGIN
worker 11 LOG:  statement: COMMIT
worker 12 LOG:  execute <unnamed>: SELECT queues.mode FROM queues
worker 12 LOG:  statement: ROLLBACK
worker 14 LOG:  statement: BEGIN
"""


def test_transactions_are_read_from_a_log_in_which_they_are_mixed() -> None:
    found = list(transactions(LOG.splitlines(keepends=True)))
    assert [(one.program, one.purpose, len(one.statements)) for one in found] == [
        ("worker", "liveness of a connection", 1),
        ("api", "work of the job", 1),
        ("worker", "heartbeat", 3),
        ("worker", "claim of nothing", 3),
    ]
    assert found[2].statements[1].endswith("WHERE jobs.id = $2")


def test_workers_that_the_database_never_holds_up_do_their_jobs_at_their_pace() -> None:
    demand = JobDemand((0.5,), 4.0, 0.0, 0.0)
    alone, many = (pace(demand, WorkerFleet(workers, 16, 0.5, 1, 1e-9)) for workers in (1, 40))
    assert alone.jobs_per_s == pytest.approx(2.0, rel=0.02)
    assert many.jobs_per_s == pytest.approx(80.0, rel=0.02)
    assert many.busy == pytest.approx(1.0, rel=0.02)


def test_a_database_that_is_used_up_gives_what_it_has() -> None:
    demand = JobDemand((0.5,), 4.0, 0.0, 0.0)
    paces = [pace(demand, WorkerFleet(workers, 16, 0.5, 1, 0.01)) for workers in (1, 200)]
    assert paces[1].jobs_per_s == pytest.approx(100.0 / 4.0, rel=0.02)
    assert paces[1].database == pytest.approx(1.0, abs=0.02)
    assert carried(paces) == pytest.approx(25.0 / (1 / (0.5 + 4 / 100.0)), rel=0.03)
