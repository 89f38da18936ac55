"""Which evaluation version is in force, was, and will be."""

from services.domain.benchmarks.phases.evaluation_versions import (
    EvaluationVersion,
    active,
    in_force,
    pending,
    versions_to_score,
)
from services.runtime.orm import Activation, Rescore
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from stone.scoring.metric import METRIC_VERSION, OCCUPIED_VERSION
from tests.services.domain.benchmarks.scored import Place, another_truth, phase_of_rows


def _rescore(place: Place, pair: EvaluationVersion, **columns: int) -> None:
    with place.platform.database.transaction() as session:
        row = Rescore(phase_id=place.phase.id, truth_id=pair.truth_id, metric=pair.metric, created_by=place.user.id)
        for name, value in columns.items():
            setattr(row, name, value)
        session.add(row)


def _activation(place: Place, pair: EvaluationVersion, at_ns: int) -> None:
    with place.platform.database.transaction() as session:
        row = Activation(phase_id=place.phase.id, truth_id=pair.truth_id, metric=pair.metric)
        row.activated_by, row.activated_ns = place.user.id, at_ns
        session.add(row)


def test_a_phase_without_ground_truth_has_no_pair_and_scores_nothing(platform: Platform) -> None:
    with platform.database.reading() as session:
        assert active(session, "0" * 32) is None
        assert in_force(session, "0" * 32) is None
        assert versions_to_score(session, "0" * 32) == ()


def test_the_newest_activation_counts_and_the_past_keeps_its_own(platform_on: Platform) -> None:
    place = phase_of_rows(platform_on)
    first = EvaluationVersion(place.truth_id, METRIC_VERSION)
    second = EvaluationVersion(another_truth(place), METRIC_VERSION)
    switched_ns = now_ns() + 10**9
    _activation(place, second, switched_ns)
    with platform_on.database.reading() as session:
        assert active(session, place.phase.id) == second
        assert active(session, place.phase.id, switched_ns) == second
        assert active(session, place.phase.id, switched_ns - 1) == first
        assert active(session, place.phase.id, 1) is None


def test_a_pair_is_pending_until_it_is_activated_or_abandoned(platform_on: Platform) -> None:
    place = phase_of_rows(platform_on)
    waiting = EvaluationVersion(another_truth(place), METRIC_VERSION)
    metric = EvaluationVersion(place.truth_id, OCCUPIED_VERSION)
    _rescore(place, waiting)
    _rescore(place, waiting)
    _rescore(place, metric)
    _rescore(place, EvaluationVersion(another_truth(place), METRIC_VERSION), abandoned_ns=1)
    _rescore(place, EvaluationVersion(another_truth(place), METRIC_VERSION), activated_ns=1)
    with platform_on.database.reading() as session:
        assert pending(session, place.phase.id) == (waiting, metric)
        assert versions_to_score(session, place.phase.id) == (
            EvaluationVersion(place.truth_id, METRIC_VERSION),
            waiting,
            metric,
        )


def test_a_pending_pair_that_is_on_the_board_is_scored_once(platform: Platform) -> None:
    place = phase_of_rows(platform)
    shown = EvaluationVersion(place.truth_id, METRIC_VERSION)
    _rescore(place, shown)
    with platform.database.reading() as session:
        assert versions_to_score(session, place.phase.id) == (shown,)
