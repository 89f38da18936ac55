"""What `benchmarks.rows.claiming` reads from a log, and its forecast against closed forms."""

import pytest

from benchmarks.rows.claiming.forecast import JobDemand, WorkerFleet, carried, demand_of, pace, transaction_s
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


def test_heartbeats_of_one_keeper_are_one_a_turn_and_so_is_presence() -> None:
    demand = JobDemand((1e6,), 1.0, 2.0, 0.25)
    together = pace(demand, WorkerFleet(32, 16, 0.5, 1, 1e-3))
    apart = pace(demand, WorkerFleet(32, 1, 0.5, 1, 1e-3))
    assert together.database * 1000 == pytest.approx(2 * 2 + 2 * 0.25, rel=0.1)
    assert apart.database * 1000 == pytest.approx(32 * 2 + 32 * 0.25, rel=0.1)


def test_a_question_whether_a_connection_lives_is_counted_to_what_follows_it() -> None:
    run = {"liveness of a connection": 10, "claim": 6, "heartbeat": 3, "presence": 1}
    idle = {"transactions": {"presence": 5, "liveness of a connection": 5}, "lasted_s": 10.0, "processes": 2}
    cost = {"run": {"transactions": run}, "idle": idle, "job_s": [1.0, 2.0]}
    assert demand_of(cost, is_shared=True) == JobDemand((1.0, 2.0), 6.0, beats_per_s=2.0, presence_per_s=1.0)
    assert demand_of(cost, is_shared=False) == JobDemand((1.0, 2.0), 9.0, beats_per_s=0.0, presence_per_s=0.5)


def test_a_database_of_two_cores_gives_twice_what_one_gives() -> None:
    demand = JobDemand((0.5,), 4.0, 0.0, 0.0)
    found = pace(demand, WorkerFleet(200, 16, 0.5, 2, 0.01))
    assert found.jobs_per_s == pytest.approx(2 * 100.0 / 4.0, rel=0.02)
    assert found.database == pytest.approx(1.0, abs=0.02)


def test_claims_and_ends_cost_what_they_cost_many_at_once_where_that_is_dearer() -> None:
    times = {"claim": 50, "end of a job": 10, "work of the job": 40}
    cost = {"run": {"transactions": times}, "cpu_s_a_job": 0.1, "job_s": [1.0, 1.0, 1.0]}
    assert transaction_s(cost, {"transactions": 1000, "database_cpu_s": 2.0}) == pytest.approx(0.003)
    assert transaction_s(cost, {"transactions": 1000, "database_cpu_s": 5.0}) == pytest.approx(
        0.6 * 0.005 + 0.4 * 0.003
    )
