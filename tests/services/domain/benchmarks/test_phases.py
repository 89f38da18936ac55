"""Benchmarks and phases: what may be made of which part, what may change when, and when a phase is open."""

from dataclasses import replace
from typing import Any

import pytest
from sqlalchemy import select

from services.domain.benchmarks.phases.errors import (
    BadPhaseError,
    EmptyPartError,
    OpenTestError,
    PhaseEndedError,
    PhaseFixedError,
)
from services.domain.benchmarks.phases.findings import findings_of
from services.domain.benchmarks.phases.ground_truths import start_truth
from services.domain.benchmarks.phases.phases import (
    NewBenchmark,
    NewPhase,
    change_phase,
    create_benchmark,
    create_phase,
    default_phases,
    phase_named,
    phase_status,
)
from services.domain.benchmarks.policy_words import WORDS, policy_sentences
from services.domain.benchmarks.visibility import TABLE
from services.runtime.access.errors import NameTakenError
from services.runtime.orm import Benchmark, Dataset, DatasetMember, Job, Phase
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from testing.api.serving import Person, person
from testing.worlds import published
from tests.services.domain.benchmarks import laid

HOUR_NS = 3600 * 10**9


@pytest.fixture
def root(platform_on: Platform) -> Person:
    return person(platform_on, "administrator")


@pytest.fixture
def dataset(platform_on: Platform, root: Person) -> Dataset:
    return laid.bare_version(platform_on, root)


def test_a_version_with_val_and_test_has_an_open_and_a_hidden_phase(
    platform_on: Platform, root: Person, dataset: Dataset
) -> None:
    with platform_on.database.transaction() as session:
        benchmark = create_benchmark(session, NewBenchmark("stone", "STONE", "", root.user_id))
        for asked in default_phases(session, dataset):
            create_phase(session, benchmark, dataset, asked)
    with platform_on.database.reading() as session:
        val, test = phase_named(session, "stone", "val"), phase_named(session, "stone", "test")
        assert phase_named(session, "stone", "train") is None
    assert val is not None
    assert (val.part, val.is_hidden, val.scorings_per_window) == ("val", False, None)
    assert test is not None
    assert (test.part, test.is_hidden, test.scorings_per_window) == ("test", True, 3)


def test_a_version_without_val_and_test_has_no_phase_by_itself(platform_on: Platform, root: Person) -> None:
    only_train = laid.version(platform_on, root, train=[published.published_sequence(platform_on, root.user_id)])
    with (
        pytest.raises(EmptyPartError, match="val or test"),
        platform_on.database.reading() as session,
    ):
        default_phases(session, only_train)


@pytest.mark.parametrize(
    ("asked", "error"),
    [
        (NewPhase("t", "test", is_hidden=False), OpenTestError),
        (NewPhase("t", "train", is_hidden=False), EmptyPartError),
    ],
)
def test_no_phase_is_made_that_would_tell_test_or_that_has_no_sequence(
    platform_on: Platform, root: Person, dataset: Dataset, asked: NewPhase, error: type[Exception]
) -> None:
    with pytest.raises(error):
        laid.phase(platform_on, root, dataset, asked)
    assert laid.rows(platform_on, select(Phase)) == []
    assert laid.rows(platform_on, select(Benchmark)) == []


OUT_OF_RANGE: tuple[dict[str, Any], ...] = (
    {"opens_ns": 5, "closes_ns": 5},
    {"opens_ns": 6, "closes_ns": 5},
    {"scorings_per_window": -1},
    {"scorings_total": 10**6 + 1},
    {"validations_per_day": -1},
    {"team_members": 0},
    {"team_members": 101},
    {"window_ns": 0},
    {"window_ns": 367 * 24 * HOUR_NS},
)


def test_a_phase_may_allow_no_scoring_at_all(platform: Platform) -> None:
    root = person(platform, "administrator")
    made = laid.phase(platform, root, laid.bare_version(platform, root), scorings_per_window=0, scorings_total=0)
    assert (made.scorings_per_window, made.scorings_total) == (0, 0)


def test_rules_out_of_range_are_refused(platform: Platform) -> None:
    root = person(platform, "administrator")
    dataset = laid.bare_version(platform, root)
    for rules in OUT_OF_RANGE:
        with pytest.raises(BadPhaseError, match="|".join(rules)):
            laid.phase(platform, root, dataset, **rules)


def test_two_that_make_a_benchmark_or_a_phase_of_one_name_at_once_make_one(
    platform_on: Platform, root: Person, dataset: Dataset
) -> None:
    asked = NewBenchmark("stone", "", "", root.user_id)
    assert sorted(laid.at_once(platform_on, *[lambda session: create_benchmark(session, asked)] * 2)) == [
        "",
        NameTakenError.code,
    ]
    benchmark = laid.rows(platform_on, select(Benchmark))[0]
    made = [lambda session: create_phase(session, benchmark, dataset, laid.TEST)] * 2
    assert sorted(laid.at_once(platform_on, *made)) == ["", NameTakenError.code]


def test_a_phase_is_open_from_its_first_moment_until_before_its_last() -> None:
    phase = Phase(opens_ns=10, closes_ns=20)
    assert [phase_status(phase, at) for at in (9, 10, 19, 20)] == ["upcoming", "open", "open", "closed"]
    assert phase_status(Phase(opens_ns=None, closes_ns=None), 0) == "open"


def test_what_is_evaluated_changes_until_a_ground_truth_is_being_made(
    platform_on: Platform, root: Person, dataset: Dataset
) -> None:
    phase = laid.phase(platform_on, root, dataset, laid.VAL)
    with platform_on.database.transaction() as session:
        assert change_phase(session, phase.id, {"mask": "lidar", "is_hidden": True}).revision == 2
        _truth, job = start_truth(session, phase, dataset, root.user_id)
    with (
        pytest.raises(PhaseFixedError, match="is_hidden, mask, part"),
        platform_on.database.transaction() as session,
    ):
        change_phase(session, phase.id, {"mask": "all", "part": "test", "is_hidden": False})
    with platform_on.database.transaction() as session:
        changed = change_phase(session, phase.id, {"mask": "lidar", "title": "the same mask is no change"})
        assert (changed.mask, changed.title, changed.revision) == ("lidar", "the same mask is no change", 3)
        session.get_one(Job, job.id).state = "failed"
    with platform_on.database.transaction() as session:
        assert change_phase(session, phase.id, {"mask": "all"}).mask == "all"


def test_a_hidden_phase_that_told_its_results_does_not_open_again(
    platform_on: Platform, root: Person, dataset: Dataset
) -> None:
    phase = laid.phase(platform_on, root, dataset, closes_ns=now_ns() - HOUR_NS)
    with platform_on.database.transaction() as session:  # nothing was scored, so nothing was told
        change_phase(session, phase.id, {"closes_ns": now_ns() - HOUR_NS // 2})
    captain = laid.user(platform_on)
    laid.entry(platform_on, phase.id, laid.team(platform_on, captain).id, captain.id)
    for later in (now_ns() + HOUR_NS, None):
        with pytest.raises(PhaseEndedError), platform_on.database.transaction() as session:
            change_phase(session, phase.id, {"closes_ns": later})


def test_labels_that_are_public_in_another_version_are_warned_of(platform_on: Platform, root: Person) -> None:
    dataset = laid.version(platform_on, root)
    test = laid.phase(platform_on, root, dataset)
    val = laid.phase(platform_on, root, dataset, replace(laid.VAL, is_hidden=True))
    open_val = laid.phase(platform_on, root, dataset, laid.VAL)

    def codes(*phases: Phase) -> list[list[str]]:
        with platform_on.database.reading() as session:
            return [[finding.code for finding in findings_of(session, phase)] for phase in phases]

    assert codes(test, val, open_val) == [[], ["labels_are_public"], []]
    members = laid.rows(platform_on, select(DatasetMember))
    ids = {row.part: [row.sequence_id] for row in members}
    laid.version(platform_on, root, train=ids["test"], test=ids["val"])  # the roles of the two exchanged
    assert codes(test, val, open_val) == [["labels_are_public"], ["labels_are_public"], ["labels_are_hidden_elsewhere"]]


def test_the_policy_in_words_names_every_field_once_for_each_state() -> None:
    assert set(WORDS) == set(TABLE)
    hidden = Phase(is_hidden=True, closes_ns=20, named_from_ns=30)
    running, ended, names = policy_sentences(hidden, 10)
    assert "administrators only: exact totals" in running
    assert "everyone: totals rounded to 4 digits, exact totals" in ended
    assert names.startswith("Until named_from_at")
    for sentence in (running, ended, *policy_sentences(Phase(is_hidden=False), 10)):
        assert all(sentence.count(word) >= 1 for word in WORDS.values())
    assert policy_sentences(hidden, 40) == (ended,)
