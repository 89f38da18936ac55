"""The page of jobs that a caller asks for, by a statement that is kept for each form of the question.

**Conventions.** Everybody lists their own; what is said of one is `api/views/jobs.py`'s.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any, Literal

from fastapi import Query
from sqlalchemy import Row, Select, select
from sqlalchemy.orm import Session

from api.lists.answers import MOST_FORMS, PageForm, form_of, newest_page, page_of, page_values
from api.paging import PageQuery
from api.schemas.base import IdQuery
from api.views.jobs import with_counts
from services.runtime.database.rows import KeptSelect, parameter
from services.runtime.orm import Job

State = Literal["queued", "running", "succeeded", "failed", "cancelled"]
Kind = Annotated[str | None, Query(pattern=r"^[a-z][a-z_]*(\.[a-z][a-z_]*)*$", max_length=64)]


@dataclass(frozen=True)
class JobFilters:
    """Which jobs a list shows; without `root_id` runs and single jobs, with it the jobs of that run."""

    state: State | None = None
    kind: Kind = None
    sequence_id: IdQuery = None
    root_id: IdQuery = None

    def wanted(self, keys: tuple[str, ...] = ("state", "kind", "sequence_id", "root_id")) -> dict[str, str]:
        """Those of the filters that are given."""
        return {key: value for key in keys if (value := getattr(self, key)) is not None}

    def equal(self, statement: Select[Job], keys: tuple[str, ...]) -> Select[Job]:
        """Rows whose columns equal the filters that are given."""
        return statement.filter_by(**self.wanted(keys))

    def one_level(self, statement: Select[Job]) -> Select[Job]:
        return one_level(statement, is_within=self.root_id is not None)


def one_level(statement: Select[Job], *, is_within: bool) -> Select[Job]:
    """Runs and single jobs, or the jobs within runs."""
    return statement.where((Job.id != Job.root_id) if is_within else (Job.id == Job.root_id))


def job_rows(
    session: Session, owner_id: str, filters: JobFilters, query: PageQuery
) -> tuple[Sequence[Row[Any]], str | None]:
    """Rows of `with_counts`, and the cursor of the next page. Raises `BadCursorError`."""
    wanted = filters.wanted()
    given = {"owner": owner_id, **{f"wanted_{key}": value for key, value in wanted.items()}}
    kept = _kept(tuple(wanted), form_of(query))
    return page_of(kept.rows(session, {**given, **page_values(query)}), query)


@lru_cache(MOST_FORMS)
def _kept(wanted: tuple[str, ...], form: PageForm) -> KeptSelect:
    """The statement of a page in this form of the question: with which filters."""
    mine = select(Job).where(Job.owner_id == parameter("owner"))
    narrowed = mine.filter_by(**{key: parameter(f"wanted_{key}") for key in wanted})
    page = newest_page(one_level(narrowed, is_within="root_id" in wanted), Job.id, form)
    return KeptSelect(with_counts(page))
