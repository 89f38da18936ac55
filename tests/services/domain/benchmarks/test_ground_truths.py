"""Ground truths: numbered, the first put in force, none that entries could not be scored by; and which was in force."""

from dataclasses import dataclass

import pytest
from sqlalchemy import select

from services.domain.benchmarks.phases.evaluation_versions import (
    EvaluationVersion,
    active,
    pending,
    versions_to_score,
)
from services.domain.benchmarks.phases.ground_truths import (
    TruthFrameComparison,
    compare_frames,
    first_activation,
    start_truth,
)
from services.runtime.orm import Activation, Dataset, DatasetMember, GroundTruthRow, Job, Phase, Rescore
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from stone.scoring.metric import METRIC_VERSION, OCCUPIED_VERSION
from testing.api.serving import Person, person
from testing.refusals import refused_as
from testing.worlds import published
from tests.services.domain.benchmarks import laid
from tests.services.domain.benchmarks.scored import Place, another_truth, phase_of_rows


@dataclass(frozen=True)
class World:
    """A phase over the test part of a version."""

    platform: Platform
    root: Person
    dataset: Dataset
    phase: Phase

    def begun(self, dataset: Dataset | None = None, compared: TruthFrameComparison | None = None) -> str:
        """The id of a ground truth of the version, or of another one."""
        with self.platform.database.transaction() as session:
            return start_truth(session, self.phase, dataset or self.dataset, self.root.user_id, compared)[0].id

    def in_force(self) -> str:
        """A ground truth that is ready and activated, as its job would have it."""
        truth_id = self.begun()
        laid.ready(self.platform, truth_id)
        with self.platform.database.transaction() as session:
            first_activation(session, session.get_one(GroundTruthRow, truth_id))
        return truth_id

    def scored(self, **columns: object) -> None:
        captain = laid.user(self.platform)
        team = laid.team(self.platform, captain)
        laid.entry(self.platform, self.phase.id, team.id, captain.id, **columns)

    def version(self, *, keeps: bool, adds: bool) -> Dataset:
        """Another version, whose test part keeps that of the first, adds a sequence, or both."""
        members = laid.rows(self.platform, select(DatasetMember)) if keeps else ()
        same = [row.sequence_id for row in members if row.part == "test"]
        new = [published.published_sequence(self.platform, self.root.user_id)] if adds else []
        return laid.version(self.platform, self.root, test=[*same, *new])


@pytest.fixture
def at(platform: Platform) -> World:
    root = person(platform, "administrator")
    dataset = laid.version(platform, root)
    return World(platform, root, dataset, laid.phase(platform, root, dataset))


def test_a_ground_truth_takes_part_and_mask_of_its_phase_and_asks_for_a_job(at: World) -> None:
    truth_id = at.begun()
    with at.platform.database.reading() as session:
        truth = session.get_one(GroundTruthRow, truth_id)
        job = session.get_one(Job, truth.job_id)
    assert (truth.number, truth.part, truth.mask, truth.ready_ns) == (1, "test", "all", None)
    assert (job.kind, job.arguments, job.owner_id) == ("eval.truth", {"truth_id": truth_id}, at.root.user_id)


def test_a_version_without_the_phases_part_makes_no_ground_truth(at: World) -> None:
    other = laid.version(at.platform, at.root, val=[published.published_sequence(at.platform, at.root.user_id)])
    with refused_as("empty_part"):
        at.begun(other)


def test_the_first_that_is_ready_is_in_force_and_a_later_one_is_not(at: World) -> None:
    assert compare_frames(at.platform, at.phase.id, at.dataset) is None
    first, second = at.in_force(), at.in_force()
    with at.platform.database.transaction() as session:
        assert active(session, at.phase.id) == EvaluationVersion(first, METRIC_VERSION)
        assert first_activation(session, session.get_one(GroundTruthRow, second)) is None
    assert len(laid.rows(at.platform, select(Activation))) == 1


def test_equal_frames_of_another_version_make_a_ground_truth_that_entries_can_be_scored_by(at: World) -> None:
    at.in_force()
    at.scored()
    newer = at.version(keeps=True, adds=False)
    with refused_as("truth_changed"):
        at.begun(newer)
    compared = compare_frames(at.platform, at.phase.id, newer)
    assert (compared.missing, compared.extra) == (0, 0)
    assert at.begun(newer, compared)


def test_other_frames_are_refused_with_their_number_once_there_are_entries(at: World) -> None:
    at.in_force()
    more, other = at.version(keeps=True, adds=True), at.version(keeps=False, adds=True)
    at.scored(kind="validation")
    at.scored(state="invalid")
    at.scored(withdrawn_ns=1)
    laid.ready(at.platform, at.begun(more))  # none of these would be on a board
    at.scored()
    for newer, missing, extra in ((more, 0, 3), (other, 3, 3)):
        compared = compare_frames(at.platform, at.phase.id, newer)
        with refused_as("other_frames", match=rf"^{missing} frame.* {extra} are new"):
            at.begun(newer, compared)


def test_frames_compared_with_another_ground_truth_count_for_nothing(at: World) -> None:
    truth_id = at.in_force()
    at.scored()
    other = at.version(keeps=False, adds=True)
    for stale in (TruthFrameComparison("0" * 32, other.id, 0, 0), TruthFrameComparison(truth_id, at.dataset.id, 0, 0)):
        with refused_as("truth_changed"):
            at.begun(other, stale)


def rescore(place: Place, version: EvaluationVersion, **columns: int) -> None:
    facts = {"phase_id": place.phase.id, "truth_id": version.truth_id, "metric": version.metric}
    with place.platform.database.transaction() as session:
        session.add(Rescore(created_by=place.user.id, **facts, **columns))


def test_the_newest_activation_counts_and_the_past_keeps_its_own(platform: Platform) -> None:
    place = phase_of_rows(platform)
    first = EvaluationVersion(place.truth_id, METRIC_VERSION)
    second = EvaluationVersion(another_truth(place), METRIC_VERSION)
    switched_ns = now_ns() + 10**9
    facts = {"phase_id": place.phase.id, "truth_id": second.truth_id, "metric": METRIC_VERSION}
    with platform.database.transaction() as session:
        session.add(Activation(activated_by=place.user.id, activated_ns=switched_ns, **facts))
    with platform.database.reading() as session:
        assert active(session, place.phase.id) == second
        assert active(session, place.phase.id, switched_ns) == second
        assert active(session, place.phase.id, switched_ns - 1) == first
        assert active(session, place.phase.id, 1) is None


def test_a_pair_is_pending_until_it_is_activated_or_abandoned(platform: Platform) -> None:
    place = phase_of_rows(platform)
    shown = EvaluationVersion(place.truth_id, METRIC_VERSION)
    waiting = EvaluationVersion(another_truth(place), METRIC_VERSION)
    metric = EvaluationVersion(place.truth_id, OCCUPIED_VERSION)
    for version in (waiting, waiting, metric):
        rescore(place, version)
    for ended in ("abandoned_ns", "activated_ns"):
        rescore(place, EvaluationVersion(another_truth(place), METRIC_VERSION), **{ended: 1})
    with platform.database.reading() as session:
        assert pending(session, place.phase.id) == (waiting, metric)
        assert versions_to_score(session, place.phase.id) == (shown, waiting, metric)


def test_a_pending_pair_that_is_on_the_board_is_scored_once(platform: Platform) -> None:
    place = phase_of_rows(platform)
    shown = EvaluationVersion(place.truth_id, METRIC_VERSION)
    rescore(place, shown)
    with platform.database.reading() as session:
        assert versions_to_score(session, place.phase.id) == (shown,)
