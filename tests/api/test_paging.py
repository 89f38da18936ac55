"""Pages meet every row once, whatever is written meanwhile, and take no cursor but their own."""

import json
from base64 import urlsafe_b64encode
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from sqlalchemy import Select, select

from api.paging import PageQuery, page
from services.runtime.orm import AuditEntry, Team
from services.runtime.platform import Platform
from stone.errors import StoneError
from testing.refusals import refused_as


def cursor_of(value: object) -> str:
    return urlsafe_b64encode(json.dumps(value).encode()).decode().rstrip("=")


@pytest.fixture
def teams(platform_on: Platform) -> list[str]:
    with platform_on.database.transaction() as session:
        rows = [Team(name=f"team {number}") for number in range(7)]
        session.add_all(rows)
        session.flush()
        return [row.id for row in rows]


def walk(platform: Platform, statement: Select[Team], order: Any, limit: int) -> Iterator[list[str]]:
    cursor: str | None = None
    while True:
        with platform.database.reading() as session:
            rows = page(session, statement, order, PageQuery(cursor, limit))
        yield [row.id for row in rows.rows]
        if rows.next is None:
            return
        cursor = rows.next


@pytest.mark.parametrize("limit", [1, 2, 3, 6, 7, 8, 200])
def test_pages_meet_every_row_once_in_order(platform_on: Platform, teams: list[str], limit: int) -> None:
    rising = list(walk(platform_on, select(Team), Team.id, limit))
    falling = list(walk(platform_on, select(Team), Team.id.desc(), limit))
    assert [each for some in rising for each in some] == sorted(teams)
    assert [each for some in falling for each in some] == sorted(teams, reverse=True)
    assert all(len(some) == limit for some in rising[:-1])
    assert 0 < len(rising[-1]) <= limit


def test_rows_that_come_and_go_meanwhile_shift_nothing(platform_on: Platform, teams: list[str]) -> None:
    pages = walk(platform_on, select(Team), Team.id, 3)
    seen = next(pages)
    with platform_on.database.transaction() as session:
        session.delete(session.get_one(Team, sorted(teams)[0]))
        session.add(Team(id="0" * 32, name="late and early"))
    assert seen + [each for some in pages for each in some] == sorted(teams)


def test_an_empty_list_has_no_next(platform: Platform) -> None:
    assert list(walk(platform, select(Team), Team.id, 3)) == [[]]


@pytest.mark.parametrize(
    "cursor",
    [
        "", "!", "é", "AAAA", cursor_of(7), cursor_of(None), cursor_of(True), cursor_of([1]), cursor_of({"a": 1}),
        cursor_of("a\x00b"), cursor_of("\ud800"), cursor_of(1.5), urlsafe_b64encode(b"[" * 300).decode(),
    ],
)  # fmt: skip
def test_a_cursor_of_another_making_is_refused(platform: Platform, cursor: str) -> None:
    with platform.database.reading() as session, refused_as("bad_cursor"):
        page(session, select(Team), Team.id, PageQuery(cursor, 10))


@pytest.mark.parametrize("value", [2**63, -(2**64), "1", True, 1e3])
def test_a_cursor_beyond_the_databases_integers_is_refused(platform: Platform, value: object) -> None:
    with platform.database.reading() as session, refused_as("bad_cursor"):
        page(session, select(AuditEntry), AuditEntry.number, PageQuery(cursor_of(value), 10))


@pytest.mark.whole
@given(cursor=st.text(max_size=600))
def test_no_text_breaks_a_list(cursor: str) -> None:
    from api import paging

    try:
        value = paging.last_of(cursor, str)
    except StoneError as error:
        if error.code != "bad_cursor":
            raise
        return
    assert isinstance(value, str)
    assert "\x00" not in value
