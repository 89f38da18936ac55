"""The simulator of a fleet by worlds whose answer is known in closed form."""

from random import Random

import pytest
from simpy import Environment, Event

from benchmarks.fleet.graph import Graph, StageJob
from benchmarks.fleet.sharing import Cores, Line, Shared
from benchmarks.fleet.simulation import Database, Fleet, simulate


def one_job(lasts_s: float) -> Graph:
    return Graph((StageJob("labeler.frames", 0.0, lasts_s),), frames=1)


def on_cores(cores: float, **more: float) -> Cores:
    return Cores(cores, **more)


def chance_of_waiting(servers: int, load: float) -> float:
    """Erlang's C formula; `load` is arrival rate × service time."""
    term, total = 1.0, 1.0
    for number in range(1, servers):
        term *= load / number
        total += term
    last = term * load / servers / (1 - load / servers)
    return last / (total + last)


def waited_s(servers: int, rate_hz: float, seed: int) -> float:
    """The mean wait for service times of one second on the average."""
    chance, at_s, arrivals = Random(seed), 0.0, []
    for _ in range(12_000):
        at_s += chance.expovariate(rate_hz)
        arrivals.append((at_s, one_job(chance.expovariate(1.0))))
    course = simulate(Fleet(servers), arrivals)
    return sum(course.ages_s) / len(course.ages_s)


@pytest.mark.parametrize(("servers", "rate_hz"), [(1, 0.5), (2, 1.2), (4, 2.4)])
def test_poisson_arrivals_wait_as_erlang_says(servers: int, rate_hz: float) -> None:
    """Waits follow each other closely, so several short worlds tell more than a long one."""
    mean_s = sum(waited_s(servers, rate_hz, seed) for seed in range(1000, 1005)) / 5
    assert mean_s == pytest.approx(chance_of_waiting(servers, rate_hz) / (servers - rate_hz), rel=0.06)


def test_regular_arrivals_that_are_served_in_time_never_wait() -> None:
    course = simulate(Fleet(1), [(float(number), one_job(0.75)) for number in range(100)])
    assert set(course.ages_s) == {0.0}
    assert course.lasts_s == 99.75


def test_regular_arrivals_that_are_served_too_slowly_wait_each_longer() -> None:
    course = simulate(Fleet(1), [(float(number), one_job(1.5)) for number in range(100)])
    assert course.ages_s == pytest.approx([0.5 * number for number in range(100)])


def test_shared_processors_serve_poisson_arrivals_as_kleinrock_says() -> None:
    """Time in an M/M/1 queue with processor sharing: 1 / (service rate − arrival rate)."""
    chance, at_s, arrivals = Random(7), 0.0, []
    for _ in range(60_000):
        at_s += chance.expovariate(0.5)
        arrivals.append((at_s, Graph((StageJob("labeler.frames", chance.expovariate(1.0)),))))
    course = simulate(Fleet(200, cores=on_cores(1)), arrivals)
    assert sum(course.stays_s) / len(course.stays_s) == pytest.approx(2.0, rel=0.08)


def diamond() -> Graph:
    """One second, then four beside each other of one to four seconds, then one."""
    first = StageJob("labeler.parts", 1.0)
    middle = tuple(StageJob("labeler.surface", float(lasts), needs=(0,)) for lasts in (1, 2, 3, 4))
    return Graph((first, *middle, StageJob("labeler.reference", 0.5, 0.5, needs=(1, 2, 3, 4))), frames=10)


def test_with_workers_enough_a_sequence_takes_its_longest_chain() -> None:
    graph = diamond()
    assert graph.critical_s == 6.0
    assert simulate(Fleet(64, cores=on_cores(64)), [(0.0, graph)]).lasts_s == pytest.approx(graph.critical_s)


def test_one_worker_takes_the_sum_and_each_dispatch() -> None:
    graph = diamond()
    assert simulate(Fleet(1, cores=on_cores(2)), [(0.0, graph)]).lasts_s == pytest.approx(graph.work_s)
    delayed = simulate(Fleet(1, cores=on_cores(2), dispatch_s=0.25), [(0.0, graph)])
    assert delayed.lasts_s == pytest.approx(graph.work_s + 6 * 0.25)


def test_more_workers_than_cores_share_them() -> None:
    equal = Graph(tuple(StageJob("labeler.surface", 1.0) for _ in range(4)))
    assert simulate(Fleet(4, cores=on_cores(2)), [(0.0, equal)]).lasts_s == pytest.approx(2.0)
    assert simulate(Fleet(4, cores=on_cores(2, taken=1.0)), [(0.0, equal)]).lasts_s == pytest.approx(4.0)
    assert simulate(Fleet(4, cores=on_cores(2, contention=1.5)), [(0.0, equal)]).lasts_s == pytest.approx(3.0)


def test_who_comes_later_slows_who_is_there_from_then_on() -> None:
    env = Environment()
    shared = Shared(env, lambda users: 1 / users)
    ends = {}

    def use(name: str, begin_s: float, amount: float) -> object:
        yield env.timeout(begin_s)
        yield shared.use(amount)
        ends[name] = env.now

    env.process(use("first", 0.0, 2.0))  # type: ignore[arg-type]
    env.process(use("second", 1.0, 0.5))  # type: ignore[arg-type]
    env.run()
    assert ends == pytest.approx({"second": 2.0, "first": 2.5})


def test_what_is_nothing_is_done_at_once() -> None:
    env = Environment()
    done: Event = Shared(env, lambda _users: 1.0).use(0.0)
    env.run()
    assert done.processed
    assert env.now == 0.0


def test_a_line_gives_each_its_share_and_none_more_than_its_own() -> None:
    moving = Graph((StageJob("labeler.fuse", 0.0, get_bytes=100.0),))
    fleet = Fleet(4, line=Line(all_bytes_per_s=100.0, each_bytes_per_s=50.0))
    assert simulate(fleet, [(0.0, moving)]).lasts_s == pytest.approx(2.0)
    course = simulate(fleet, [(0.0, moving)] * 4)
    assert course.lasts_s == pytest.approx(4.0)
    assert course.moved_bytes == 400.0


def test_the_database_bounds_how_many_jobs_begin_in_a_second() -> None:
    asking = Graph((StageJob("labeler.fuse", 0.0, 0.001, transactions=10.0),))
    fleet = Fleet(1000, database=Database(servers=2, transaction_s=0.01))
    course = simulate(fleet, [(0.0, asking)] * 200)
    assert course.lasts_s == pytest.approx(200 * 10 * 0.01 / 2, rel=0.02)
    assert course.transactions == 2000.0


def test_older_runs_are_finished_before_younger_ones_are_begun() -> None:
    arrivals = [(0.0, diamond()) for _ in range(20)]
    by_run = simulate(Fleet(1, order="run"), arrivals)
    by_job = simulate(Fleet(1, order="job"), arrivals)
    assert by_run.lasts_s == pytest.approx(by_job.lasts_s)
    assert (by_run.most_open, by_job.most_open) == (1, 20)
    assert sum(by_run.stays_s) < 0.6 * sum(by_job.stays_s)


def test_the_urgent_go_first() -> None:
    last = Graph((StageJob("labeler.export", 1.0, priority=-1),))
    first = Graph((StageJob("labeler.frames", 1.0),))
    assert simulate(Fleet(1), [(0.0, last), (0.0, last), (0.0, first)]).stays_s == pytest.approx([1.0, 2.0, 3.0])


def test_a_job_that_needs_a_later_one_is_refused() -> None:
    with pytest.raises(ValueError, match="only jobs before it"):
        Graph((StageJob("labeler.fuse", 1.0, needs=(1,)), StageJob("labeler.fuse", 1.0)))


def test_nothing_to_do_lasts_no_time() -> None:
    assert simulate(Fleet(3), []).lasts_s == 0.0
    assert Graph(()).critical_s == 0.0
