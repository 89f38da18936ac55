"""Reported rows: put as a whole, each method and modality once, and the same row as before where nothing changed."""

from dataclasses import replace

import pytest
from sqlalchemy import select
from sqlalchemy.orm import Session

from services.domain.benchmarks.phases.reported_results import (
    ReportedRow,
    ReportedTwiceError,
    put_reported,
    reported_in,
)
from services.runtime.orm import Phase, Reported
from services.runtime.platform import Platform
from testing.api.serving import person
from tests.services.domain.benchmarks import laid

A = ReportedRow("a method", "C", "somebody, some year, some table", iou_occ=0.5, miou=0.25)
B = ReportedRow("b method", "C+L", "somebody, some year, some table")


@pytest.fixture
def phase(platform_on: Platform) -> Phase:
    root = person(platform_on, "administrator")
    return laid.phase(platform_on, root, laid.bare_version(platform_on, root))


def put(platform: Platform, phase: Phase, *rows: ReportedRow) -> list[Reported]:
    with platform.database.transaction() as session:
        return put_reported(session, phase, rows)


def test_what_is_put_is_what_stands_and_nothing_else(platform_on: Platform, phase: Phase) -> None:
    first = put(platform_on, phase, B, A)
    assert [(row.method, row.modality, row.iou_occ, row.miou) for row in first] == [
        ("a method", "C", 0.5, 0.25),
        ("b method", "C+L", None, None),
    ]
    again = put(platform_on, phase, A, B)
    assert [row.id for row in again] == [row.id for row in first]
    erratum = replace(A, miou=None, source="an erratum", note="of another split", percent_digits=1)
    changed = put(platform_on, phase, erratum, replace(A, modality="L"))
    assert [(row.modality, row.miou, row.source, row.note, row.percent_digits) for row in changed] == [
        ("C", None, "an erratum", "of another split", 1),
        ("L", 0.25, A.source, "", 2),
    ]
    assert changed[0].id == first[0].id
    assert put(platform_on, phase) == []


def test_a_method_that_stands_twice_with_one_modality_changes_nothing(platform_on: Platform, phase: Phase) -> None:
    put(platform_on, phase, A)
    with pytest.raises(ReportedTwiceError, match="'a method' stands twice with modality C"):
        put(platform_on, phase, B, A, replace(A, miou=0.9))
    with platform_on.database.reading() as session:
        assert [row.method for row in reported_in(session, phase.id)] == ["a method"]


def test_two_who_put_at_once_leave_the_rows_of_one(platform_on: Platform, phase: Phase) -> None:
    lists = ([A, B], [replace(A, method="c method"), B])
    assert laid.at_once(platform_on, *[_putting(phase, rows) for rows in lists]) == ["", ""]
    stand = {row.method for row in laid.rows(platform_on, select(Reported))}
    assert stand in ({"a method", "b method"}, {"c method", "b method"})


def _putting(phase: Phase, rows: list[ReportedRow]) -> laid.Act:
    def act(session: Session) -> object:
        return put_reported(session, phase, rows)

    return act
