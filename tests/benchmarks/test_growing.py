"""Growing fleets: what is not short scales, what is short bounds the pace, and prices are plain sums."""

from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.fleet.graph import Graph, StageJob
from benchmarks.fleet.growing import grown, step
from benchmarks.fleet.measuring import Measured, TimedJob, measured_of, record_of
from benchmarks.fleet.pictures import draw_forecasts, draw_growth
from benchmarks.fleet.predicting import contention_of, forecast, middle
from benchmarks.fleet.pricing import Prices, cost_of
from benchmarks.fleet.sharing import Cores, Line
from benchmarks.fleet.simulation import Database, Fleet

GRAPH = Graph(
    (
        StageJob("labeler.parts", 1.0, transactions=10.0),
        *(StageJob("labeler.fuse", 2.0, needs=(0,), transactions=10.0, put_bytes=1e6) for _ in range(4)),
        StageJob("labeler.publish", 1.0, needs=(1, 2, 3, 4), transactions=10.0),
    ),
    frames=100,
)
ROOMY = Fleet(1, per_machine=4, cores=Cores(4))


def test_twice_the_workers_do_twice_the_sequences_while_nothing_is_short() -> None:
    few, many = grown(GRAPH, ROOMY, [4, 8])
    assert many.sequences_per_h == pytest.approx(2 * few.sequences_per_h, rel=0.03)
    assert few.efficiency == pytest.approx(1.0, rel=0.03)
    assert few.frames_per_s == pytest.approx(few.sequences_per_h / 36)


def test_what_is_less_urgent_is_work_too_and_nobody_is_busier_than_all_the_time() -> None:
    later = StageJob("labeler.export", 8.0, needs=(5,), priority=-1)
    found = step(Graph((*GRAPH.jobs, later), frames=100), ROOMY, 60)
    assert found.efficiency == pytest.approx(1.0, rel=0.03)
    assert found.sequences_per_h == pytest.approx(3600 / 18, rel=0.03)
    assert found.most_open <= 2, "one run after another, though what is less urgent waits"


def test_a_database_that_is_short_bounds_the_pace_of_any_number() -> None:
    short = replace(ROOMY, workers=64, database=Database(servers=2, transaction_s=0.02))
    found = step(GRAPH, short, 200)
    assert found.transactions_per_s == pytest.approx(100.0, rel=0.05)
    assert found.database_ratio == pytest.approx(1.0, rel=0.05)
    assert found.efficiency < 0.3


def test_a_line_that_is_short_bounds_the_pace_too() -> None:
    found = step(GRAPH, replace(ROOMY, workers=64, line=Line(all_bytes_per_s=4e6)), 400)
    assert found.bytes_per_s == pytest.approx(4e6, rel=0.05)
    assert found.line_ratio == pytest.approx(1.0, rel=0.05)


def test_a_thousand_frames_cost_their_share_of_every_hour_and_of_what_is_kept() -> None:
    prices = Prices(worker_per_h=0.1, database_per_h=1.0, others_per_h=0.5, kept_gb_month=0.02, kept_months=10)
    cost = cost_of(frames_per_s=1000 / 3600, workers=20, kept_bytes_per_frame=1e6, prices=prices)
    assert (cost.workers, cost.servers, cost.kept) == pytest.approx((2.0, 1.5, 0.2))
    assert cost.total == pytest.approx(3.7)
    with pytest.raises(ValueError, match="no finite amount"):
        cost_of(0.0, 1, 1.0, prices)


def measured(workers: int, taken: float, *spans: tuple[float, float, float, tuple[int, ...]]) -> Measured:
    """Jobs from begin to end with so much processor time, the first of them before the run."""
    jobs = [TimedJob("ingest.register", -3.0, -1.0, 1.0, (), 0, is_run=False)]
    jobs += [TimedJob("labeler.fuse", begin, end, cpu, needs, 0, is_run=True) for begin, end, cpu, needs in spans]
    return Measured(workers, 2, taken, 10, tuple(jobs))


BASE = measured(1, 0.0, (0.0, 2.0, 2.0, (0,)), (2.0, 6.0, 4.0, (1,)), (6.0, 10.0, 4.0, (1,)), (10.0, 12.0, 1.5, (2, 3)))


def test_a_run_with_one_worker_foretells_itself_and_others() -> None:
    assert BASE.wall_s == 12.0
    assert BASE.graph().jobs[-1].wait_s == pytest.approx(0.5)
    assert forecast(BASE, 1.0, BASE).error == pytest.approx(0.0)
    two = measured(2, 0.0, (0.0, 2.0, 2.0, (0,)), (2.0, 6.0, 4.0, (1,)), (2.0, 6.0, 4.0, (1,)), (6.0, 8.0, 1.5, (2, 3)))
    assert forecast(BASE, 1.0, two).predicted_s == pytest.approx(8.0)
    assert forecast(BASE, 1.5, two).predicted_s == pytest.approx(10.0)
    assert not forecast(BASE, 2.0, two).is_within


def test_what_others_took_is_not_held_against_the_forecast() -> None:
    crowded = replace(BASE, taken=1.5)
    assert forecast(BASE, 1.0, crowded).predicted_s == pytest.approx(11.5 / 0.5 + 0.5)


def test_contention_is_how_much_more_processor_time_strangers_take() -> None:
    slower = measured(1, 0.0, (0.0, 15.0, 13.8, (0,)))
    assert contention_of([BASE], [slower, slower]) == pytest.approx(1.2)
    assert contention_of([slower], [BASE]) == 1.0


def test_the_round_in_the_middle_counts_and_comes_back_from_json() -> None:
    longer = measured(1, 0.0, (0.0, 20.0, 11.5, (0,)))
    longest = measured(1, 0.0, (0.0, 30.0, 11.5, (0,)))
    assert middle([longest, BASE, longer]) == longer
    assert measured_of(record_of(BASE)) == BASE


def test_pictures_are_drawn(tmp_path: Path) -> None:
    steps = list(grown(GRAPH, ROOMY, [4, 8]))
    draw_growth(steps, tmp_path / "growth.png")
    draw_forecasts(BASE.wall_s, [forecast(BASE, 1.0, BASE)], tmp_path / "forecasts.png")
    assert all((tmp_path / name).read_bytes().startswith(b"\x89PNG") for name in ("growth.png", "forecasts.png"))
