"""Benchmarks and phases: what may be made of which part, what may change when, what others reported of them."""

from dataclasses import replace
from typing import Any

import pytest
from sqlalchemy import select

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
from services.domain.benchmarks.phases.reported_results import ReportedRow, put_reported, reported_in
from services.runtime.orm import Benchmark, Dataset, DatasetMember, Job, Phase, Reported
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from testing.api.serving import Person, person
from testing.refusals import refused_as
from testing.worlds import published
from tests.services.domain.benchmarks import laid

HOUR_NS = 3600 * 10**9


@pytest.fixture
def root(platform: Platform) -> Person:
    return person(platform, "administrator")


@pytest.fixture
def dataset(platform: Platform, root: Person) -> Dataset:
    return laid.bare_version(platform, root)


def test_a_version_with_val_and_test_has_an_open_and_a_hidden_phase(
    platform: Platform, root: Person, dataset: Dataset
) -> None:
    with platform.database.transaction() as session:
        benchmark = create_benchmark(session, NewBenchmark("stone", "STONE", "", root.user_id))
        for asked in default_phases(session, dataset):
            create_phase(session, benchmark, dataset, asked)
    with platform.database.reading() as session:
        val, test = phase_named(session, "stone", "val"), phase_named(session, "stone", "test")
        assert phase_named(session, "stone", "train") is None
    assert (val.part, val.is_hidden, val.scorings_per_window) == ("val", False, None)
    assert (test.part, test.is_hidden, test.scorings_per_window) == ("test", True, 3)


def test_a_version_without_val_and_test_has_no_phase_by_itself(platform: Platform, root: Person) -> None:
    only_train = laid.version(platform, root, train=[published.published_sequence(platform, root.user_id)])
    with refused_as("empty_part"), platform.database.reading() as session:
        default_phases(session, only_train)


def test_no_phase_is_made_that_would_tell_test_or_that_has_no_sequence(
    platform: Platform, root: Person, dataset: Dataset
) -> None:
    for part, error in (("test", "open_test"), ("train", "empty_part")):
        with refused_as(error):
            laid.phase(platform, root, dataset, NewPhase("t", part, is_hidden=False))
    assert laid.rows(platform, select(Phase)) == []
    assert laid.rows(platform, select(Benchmark)) == []


def test_only_a_hidden_phase_keeps_order_and_poses_back(platform: Platform, root: Person, dataset: Dataset) -> None:
    for part, is_hidden, every_nth in (("val", False, 2), ("test", True, 0), ("test", True, 1001)):
        with refused_as("bad_phase"):
            laid.phase(platform, root, dataset, NewPhase("t", part, is_hidden, every_nth=every_nth))
    phases = [laid.phase(platform, root, dataset, NewPhase("t", "test", True, every_nth=n)) for n in (None, 1, 5)]
    assert [phase.every_nth for phase in phases] == [None, 1, 5]
    keys = [phase.token_key for phase in phases]
    assert (keys[0], len(set(keys)), {len(key or "") for key in keys[1:]}) == (None, 3, {64})
    with refused_as("bad_phase"), platform.database.transaction() as session:
        change_phase(session, phases[2].id, {"is_hidden": False, "part": "val"})


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


def test_rules_out_of_range_are_refused_and_a_phase_may_allow_no_scoring(
    platform: Platform, root: Person, dataset: Dataset
) -> None:
    made = laid.phase(platform, root, dataset, scorings_per_window=0, scorings_total=0)
    assert (made.scorings_per_window, made.scorings_total) == (0, 0)
    for rules in OUT_OF_RANGE:
        with refused_as("bad_phase", match="|".join(rules)):
            laid.phase(platform, root, dataset, **rules)


def test_a_phase_is_open_from_its_first_moment_until_before_its_last() -> None:
    phase = Phase(opens_ns=10, closes_ns=20)
    assert [phase_status(phase, at) for at in (9, 10, 19, 20)] == ["upcoming", "open", "open", "closed"]
    assert phase_status(Phase(opens_ns=None, closes_ns=None), 0) == "open"


def test_what_is_evaluated_changes_until_a_ground_truth_is_being_made(
    platform: Platform, root: Person, dataset: Dataset
) -> None:
    phase = laid.phase(platform, root, dataset, laid.VAL)
    with platform.database.transaction() as session:
        assert change_phase(session, phase.id, {"mask": "lidar", "is_hidden": True}).revision == 2
        _truth, job = start_truth(session, phase, dataset, root.user_id)
    fixed = refused_as("phase_fixed", match="is_hidden, mask, part")
    with fixed, platform.database.transaction() as session:
        change_phase(session, phase.id, {"mask": "all", "part": "test", "is_hidden": False})
    with platform.database.transaction() as session:
        changed = change_phase(session, phase.id, {"mask": "lidar", "title": "the same mask is no change"})
        assert (changed.mask, changed.title, changed.revision) == ("lidar", "the same mask is no change", 3)
        session.get_one(Job, job.id).state = "failed"
    with platform.database.transaction() as session:
        assert change_phase(session, phase.id, {"mask": "all"}).mask == "all"


def test_a_hidden_phase_that_told_its_results_does_not_open_again(
    platform: Platform, root: Person, dataset: Dataset
) -> None:
    phase = laid.phase(platform, root, dataset, closes_ns=now_ns() - HOUR_NS)
    with platform.database.transaction() as session:  # nothing was scored, so nothing was told
        change_phase(session, phase.id, {"closes_ns": now_ns() - HOUR_NS // 2})
    captain = laid.user(platform)
    laid.entry(platform, phase.id, laid.team(platform, captain).id, captain.id)
    for later in (now_ns() + HOUR_NS, None):
        with refused_as("phase_ended"), platform.database.transaction() as session:
            change_phase(session, phase.id, {"closes_ns": later})


def test_labels_that_are_public_in_another_version_are_warned_of(platform: Platform, root: Person) -> None:
    dataset = laid.version(platform, root)
    test = laid.phase(platform, root, dataset)
    val = laid.phase(platform, root, dataset, replace(laid.VAL, is_hidden=True))
    open_val = laid.phase(platform, root, dataset, laid.VAL)

    def codes(*phases: Phase) -> list[list[str]]:
        with platform.database.reading() as session:
            return [[finding.code for finding in findings_of(session, phase)] for phase in phases]

    assert codes(test, val, open_val) == [[], ["labels_are_public"], []]
    members = laid.rows(platform, select(DatasetMember))
    ids = {row.part: [row.sequence_id] for row in members}
    laid.version(platform, root, train=ids["test"], test=ids["val"])  # the roles of the two exchanged
    assert codes(test, val, open_val) == [["labels_are_public"], ["labels_are_public"], ["labels_are_hidden_elsewhere"]]


A = ReportedRow("a method", "C", "somebody, some year, some table", iou_occ=0.5, miou=0.25)
B = ReportedRow("b method", "C+L", "somebody, some year, some table")


def put(platform: Platform, phase: Phase, *rows: ReportedRow) -> list[Reported]:
    with platform.database.transaction() as session:
        return put_reported(session, phase, rows)


def test_what_is_put_is_what_stands_and_nothing_else(platform: Platform) -> None:
    phase = laid.hidden_phase(platform)
    first = put(platform, phase, B, A)
    assert [(row.method, row.modality, row.iou_occ, row.miou) for row in first] == [
        ("a method", "C", 0.5, 0.25),
        ("b method", "C+L", None, None),
    ]
    again = put(platform, phase, A, B)
    assert [row.id for row in again] == [row.id for row in first]
    erratum = replace(A, miou=None, source="an erratum", note="of another split", percent_digits=1)
    changed = put(platform, phase, erratum, replace(A, modality="L"))
    assert [(row.modality, row.miou, row.source, row.note, row.percent_digits) for row in changed] == [
        ("C", None, "an erratum", "of another split", 1),
        ("L", 0.25, A.source, "", 2),
    ]
    assert changed[0].id == first[0].id
    assert put(platform, phase) == []


def test_a_method_that_stands_twice_with_one_modality_changes_nothing(platform: Platform) -> None:
    phase = laid.hidden_phase(platform)
    put(platform, phase, A)
    with refused_as("reported_twice"):
        put(platform, phase, B, A, replace(A, miou=0.9))
    with platform.database.reading() as session:
        assert [row.method for row in reported_in(session, phase.id)] == ["a method"]
