"""The page of sequences that a caller asks for, by a statement that is kept for each form of the question.

**Conventions.** Who may see which sequence is `api/visible.py`'s, what is said of one `api/views/sequences.py`'s.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any

from fastapi import Query
from sqlalchemy import BindParameter, Row, Select, func
from sqlalchemy.orm import Session

from api.deps import Caller
from api.lists.answers import MOST_FORMS, PageForm, form_of, newest_page, page_of, page_values
from api.paging import PageQuery
from api.schemas.base import PLAIN, IdQuery, LineQuery
from api.views.sequences import with_glances
from api.visible import sequences_shown
from services.runtime.database.rows import KeptSelect, parameter
from services.runtime.orm import SequenceRow

Prefix = Annotated[str | None, Query(pattern=PLAIN, max_length=100)]
Wanted = Mapping[str, str | BindParameter[str]]


@dataclass(frozen=True)
class SequenceFilters:
    """Which sequences a list shows: equal values, and names that begin with `name`."""

    environment: LineQuery = None
    illumination: LineQuery = None
    region: LineQuery = None
    platform: LineQuery = None
    name: Prefix = None
    owner_id: IdQuery = None

    @property
    def wanted(self) -> dict[str, str]:
        """Those that are given."""
        return {name: value for name, value in vars(self).items() if value is not None}

    def narrowed(self, statement: Select[SequenceRow]) -> Select[SequenceRow]:
        return narrowed_by(statement, self.wanted)


def narrowed_by(statement: Select[SequenceRow], wanted: Wanted) -> Select[SequenceRow]:
    """The sequences with these values, or with those that the parameters will have."""
    for key, value in wanted.items():
        is_equal = getattr(SequenceRow, key) == value
        begins = func.substr(SequenceRow.name, 1, func.length(value)) == value
        statement = statement.where(begins if key == "name" else is_equal)
    return statement


def sequence_rows(
    session: Session, caller: Caller, filters: SequenceFilters, query: PageQuery
) -> tuple[Sequence[Row[Any]], str | None]:
    """Rows of `with_glances`, and the cursor of the next page. Raises `BadCursorError`."""
    wanted = filters.wanted
    kept = _kept(caller.is_administrator, tuple(wanted), form_of(query))
    given = {"caller": caller.user_id, **{f"wanted_{key}": value for key, value in wanted.items()}}
    return page_of(kept.rows(session, {**given, **page_values(query)}), query)


@lru_cache(MOST_FORMS)
def _kept(is_administrator: bool, wanted: tuple[str, ...], form: PageForm) -> KeptSelect:
    """The statement of a page in this form of the question: by whom, and with which filters."""
    caller = None if is_administrator else parameter("caller")
    named = {key: parameter(f"wanted_{key}") for key in wanted}
    page = newest_page(narrowed_by(sequences_shown(caller), named), SequenceRow.id, form)
    return KeptSelect(with_glances(page, caller))
