"""Ground truths: numbered, made one at a time, the first put in force, and none that entries could not be scored by."""

import pytest
from sqlalchemy import select

from services.domain.benchmarks.phases import evaluation_versions
from services.domain.benchmarks.phases.errors import (
    EmptyPartError,
    FramesUncomparedError,
    OtherFramesError,
    TruthInMakingError,
)
from services.domain.benchmarks.phases.ground_truths import (
    TruthFrameComparison,
    compare_frames,
    first_activation,
    start_truth,
)
from services.runtime.orm import Activation, Dataset, DatasetMember, GroundTruthRow, Job, Phase
from services.runtime.platform import Platform
from stone.scoring.metric import METRIC_VERSION
from testing.api.serving import Person, person
from testing.worlds import published
from tests.services.domain.benchmarks import laid


@pytest.fixture
def root(platform_on: Platform) -> Person:
    return person(platform_on, "administrator")


@pytest.fixture
def dataset(platform_on: Platform, root: Person) -> Dataset:
    return laid.version(platform_on, root)


@pytest.fixture
def phase(platform_on: Platform, root: Person, dataset: Dataset) -> Phase:
    return laid.phase(platform_on, root, dataset)


def begun(
    platform: Platform, phase: Phase, dataset: Dataset, root: Person, compared: TruthFrameComparison | None = None
) -> str:
    with platform.database.transaction() as session:
        return start_truth(session, phase, dataset, root.user_id, compared)[0].id


def in_force(platform: Platform, phase: Phase, dataset: Dataset, root: Person) -> str:
    """A ground truth that is ready and activated, as its job would have it."""
    truth_id = begun(platform, phase, dataset, root)
    laid.ready(platform, truth_id)
    with platform.database.transaction() as session:
        first_activation(session, session.get_one(GroundTruthRow, truth_id))
    return truth_id


def scored(platform: Platform, phase: Phase, **columns: object) -> None:
    captain = laid.user(platform)
    laid.entry(platform, phase.id, laid.team(platform, captain).id, captain.id, **columns)


def test_a_ground_truth_takes_part_and_mask_of_its_phase_and_asks_for_a_job(
    platform_on: Platform, phase: Phase, dataset: Dataset, root: Person
) -> None:
    truth_id = begun(platform_on, phase, dataset, root)
    with platform_on.database.reading() as session:
        truth = session.get_one(GroundTruthRow, truth_id)
        job = session.get_one(Job, truth.job_id)
    assert (truth.number, truth.part, truth.mask, truth.ready_ns) == (1, "test", "all", None)
    assert (job.kind, job.arguments, job.owner_id) == ("eval.truth", {"truth_id": truth_id}, root.user_id)


def test_one_is_made_at_a_time_and_numbers_count_on_after_failures(
    platform_on: Platform, phase: Phase, dataset: Dataset, root: Person
) -> None:
    codes = laid.at_once(platform_on, *[lambda session: start_truth(session, phase, dataset, root.user_id)] * 2)
    assert sorted(codes) == ["", TruthInMakingError.code]
    with platform_on.database.transaction() as session:
        session.scalars(select(Job).where(Job.kind == "eval.truth")).one().state = "failed"
    begun(platform_on, phase, dataset, root)
    assert sorted(row.number for row in laid.rows(platform_on, select(GroundTruthRow))) == [1, 2]


def test_a_version_without_the_phases_part_makes_no_ground_truth(
    platform_on: Platform, phase: Phase, root: Person
) -> None:
    other = laid.version(platform_on, root, val=[published.published_sequence(platform_on, root.user_id)])
    with pytest.raises(EmptyPartError):
        begun(platform_on, phase, other, root)


def test_the_first_that_is_ready_is_in_force_and_a_later_one_is_not(
    platform_on: Platform, phase: Phase, dataset: Dataset, root: Person
) -> None:
    first = in_force(platform_on, phase, dataset, root)
    second = in_force(platform_on, phase, dataset, root)
    with platform_on.database.transaction() as session:
        assert evaluation_versions.active(session, phase.id) == evaluation_versions.EvaluationVersion(
            first, METRIC_VERSION
        )
        assert first_activation(session, session.get_one(GroundTruthRow, second)) is None
    assert len(laid.rows(platform_on, select(Activation))) == 1


def test_equal_frames_of_another_version_make_a_ground_truth_that_entries_can_be_scored_by(
    platform_on: Platform, phase: Phase, dataset: Dataset, root: Person
) -> None:
    in_force(platform_on, phase, dataset, root)
    scored(platform_on, phase)
    same = [row.sequence_id for row in laid.rows(platform_on, select(DatasetMember)) if row.part == "test"]
    newer = laid.version(platform_on, root, test=same)
    with pytest.raises(FramesUncomparedError):
        begun(platform_on, phase, newer, root)
    compared = compare_frames(platform_on, phase.id, newer)
    assert compared is not None
    assert (compared.missing, compared.extra) == (0, 0)
    assert begun(platform_on, phase, newer, root, compared)


def test_other_frames_are_refused_with_their_number_once_there_are_entries(
    platform_on: Platform, phase: Phase, dataset: Dataset, root: Person
) -> None:
    in_force(platform_on, phase, dataset, root)
    same = [row.sequence_id for row in laid.rows(platform_on, select(DatasetMember)) if row.part == "test"]
    more = laid.version(platform_on, root, test=[*same, published.published_sequence(platform_on, root.user_id)])
    other = laid.version(platform_on, root, test=[published.published_sequence(platform_on, root.user_id)])
    scored(platform_on, phase, kind="validation")
    scored(platform_on, phase, state="invalid")
    scored(platform_on, phase, withdrawn_ns=1)
    laid.ready(platform_on, begun(platform_on, phase, more, root))  # none of these would be on a board
    scored(platform_on, phase)
    for newer, missing, extra in ((more, 0, 3), (other, 3, 3)):
        compared = compare_frames(platform_on, phase.id, newer)
        with pytest.raises(OtherFramesError, match=rf"^{missing} frame.* {extra} are new"):
            begun(platform_on, phase, newer, root, compared)


def test_frames_compared_with_another_ground_truth_count_for_nothing(
    platform_on: Platform, phase: Phase, dataset: Dataset, root: Person
) -> None:
    truth_id = in_force(platform_on, phase, dataset, root)
    scored(platform_on, phase)
    other = laid.version(platform_on, root, test=[published.published_sequence(platform_on, root.user_id)])
    for stale in (TruthFrameComparison("0" * 32, other.id, 0, 0), TruthFrameComparison(truth_id, dataset.id, 0, 0)):
        with pytest.raises(FramesUncomparedError):
            begun(platform_on, phase, other, root, stale)


def test_before_the_first_there_is_nothing_to_compare_with(
    platform_on: Platform, phase: Phase, dataset: Dataset
) -> None:
    assert compare_frames(platform_on, phase.id, dataset) is None
