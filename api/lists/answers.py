"""The response of a list: its rows as JSON, or 304 if the client's copy is current.

**Conventions.** Items are dictionaries in the shape and order of their schema (`tests/api/listed/` holds the bytes).
The ETag is the hash of these bytes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any, Literal, TypeVar

from fastapi import Query, Request, Response
from pydantic import BaseModel
from pydantic_core import to_json
from sqlalchemy import BindParameter, Integer, Row, Select, func, literal_column, select
from sqlalchemy.orm import InstrumentedAttribute, Session

from api.answers import Responses, refusals
from api.compression import tagged_response
from api.deps import Caller
from api.paging import PageQuery, cursor_after, last_of
from api.schemas.base import PLAIN, IdQuery, LineQuery
from api.views.jobs import with_counts
from api.views.sequences import with_glances
from api.visible import sequences_shown
from services.runtime.database.rows import KeptSelect, Values, parameter
from services.runtime.orm import Job, SequenceRow

JSON_TYPE = "application/json"
MOST_FORMS = 500
Item = Mapping[str, Any]
T = TypeVar("T")


def listed(*statuses: int) -> Responses:
    """Return the OpenAPI responses of a list besides 200: 304 and these refusals."""
    return {304: {"description": "The caller's copy is current"}, **refusals(*statuses)}


@dataclass(frozen=True)
class PageForm:
    """The parts of a page that change its statement: whether it follows another page, and its length.

    Without the length as a literal, the query planner considers full scans of other tables.
    """

    goes_on: bool
    limit: int


def form_of(query: PageQuery) -> PageForm:
    return PageForm(query.cursor is not None, query.limit)


def newest_page(statement: Select[T], ids: InstrumentedAttribute[str], form: PageForm) -> Select[T]:
    """Return the statement of one page plus one row, newest first; `page_values` returns its parameters."""
    page = statement.where(ids < parameter("last")) if form.goes_on else statement
    return page.order_by(ids.desc()).limit(literal_column(str(form.limit + 1), Integer))


def page_values(query: PageQuery) -> Values:
    """Return the parameters of a page's statement, ordered by ids. Raises `bad_cursor`."""
    return {} if query.cursor is None else {"last": str(last_of(query.cursor, str))}


def page_of(rows: Sequence[Row[Any]], query: PageQuery) -> tuple[Sequence[Row[Any]], str | None]:
    """Return the rows of the page without the extra row, and the cursor of the next page."""
    if len(rows) <= query.limit:
        return rows, None
    return rows[: query.limit], cursor_after(rows[query.limit - 1].id)


def list_response(request: Request, items: Sequence[Item], following: str | None) -> Response:
    """Return the page, or 304 if the client's copy is current."""
    return tagged_response(request, to_json({"items": items, "next": following}), JSON_TYPE)


def model_response(request: Request, page: BaseModel) -> Response:
    """Return a page of models, serialised once; FastAPI would validate and serialise a returned model in another
    thread.
    """
    return tagged_response(request, page.model_dump_json().encode(), JSON_TYPE)


# The page of jobs for a caller, by a statement that is cached for each form of the query.
#
# **Conventions.** Users list their own jobs; `api/views/jobs.py` defines the fields of a job.


State = Literal["queued", "running", "succeeded", "failed", "cancelled"]
Kind = Annotated[str | None, Query(pattern=r"^[a-z][a-z_]*(\.[a-z][a-z_]*)*$", max_length=64)]


@dataclass(frozen=True)
class JobFilters:
    """The filters of a job list. Without `root_id` it shows runs and single jobs, with it the jobs of that run."""

    state: State | None = None
    kind: Kind = None
    sequence_id: IdQuery = None
    root_id: IdQuery = None

    def wanted(self, keys: tuple[str, ...] = ("state", "kind", "sequence_id", "root_id")) -> dict[str, str]:
        """Return the given filters."""
        return {key: value for key in keys if (value := getattr(self, key)) is not None}

    def equal(self, statement: Select[Job], keys: tuple[str, ...]) -> Select[Job]:
        """Limit the statement to rows whose columns equal the given filters."""
        return statement.filter_by(**self.wanted(keys))

    def one_level(self, statement: Select[Job]) -> Select[Job]:
        return one_level(statement, is_within=self.root_id is not None)


def one_level(statement: Select[Job], *, is_within: bool) -> Select[Job]:
    """Limit the statement to runs and single jobs, or to the jobs within runs."""
    return statement.where((Job.id != Job.root_id) if is_within else (Job.id == Job.root_id))


def job_rows(
    session: Session, owner_id: str, filters: JobFilters, query: PageQuery
) -> tuple[Sequence[Row[Any]], str | None]:
    """Return rows of `with_counts`, and the cursor of the next page. Raises `bad_cursor`."""
    wanted = filters.wanted()
    given = {"owner": owner_id, **{f"wanted_{key}": value for key, value in wanted.items()}}
    kept = _kept(tuple(wanted), form_of(query))
    return page_of(kept.rows(session, {**given, **page_values(query)}), query)


@lru_cache(MOST_FORMS)
def _kept(wanted: tuple[str, ...], form: PageForm) -> KeptSelect:
    """Return the cached statement of a page with these filters."""
    mine = select(Job).where(Job.owner_id == parameter("owner"))
    narrowed = mine.filter_by(**{key: parameter(f"wanted_{key}") for key in wanted})
    page = newest_page(one_level(narrowed, is_within="root_id" in wanted), Job.id, form)
    return KeptSelect(with_counts(page))


# The page of sequences for a caller, by a statement that is cached for each form of the query.
#
# **Conventions.** `api/visible.py` decides who may see which sequence; `api/views/sequences.py` defines its fields.


Prefix = Annotated[str | None, Query(pattern=PLAIN, max_length=100)]
Wanted = Mapping[str, str | BindParameter[str]]


@dataclass(frozen=True)
class SequenceFilters:
    """The filters of a sequence list: equal values, and names that start with `name`."""

    environment: LineQuery = None
    illumination: LineQuery = None
    region: LineQuery = None
    platform: LineQuery = None
    name: Prefix = None
    owner_id: IdQuery = None

    @property
    def wanted(self) -> dict[str, str]:
        """Return the given filters."""
        return {name: value for name, value in vars(self).items() if value is not None}

    def narrowed(self, statement: Select[SequenceRow]) -> Select[SequenceRow]:
        return narrowed_by(statement, self.wanted)


def narrowed_by(statement: Select[SequenceRow], wanted: Wanted) -> Select[SequenceRow]:
    """Limit the statement to sequences with these values, or with bound parameters for them."""
    for key, value in wanted.items():
        is_equal = getattr(SequenceRow, key) == value
        begins = func.substr(SequenceRow.name, 1, func.length(value)) == value
        statement = statement.where(begins if key == "name" else is_equal)
    return statement


def sequence_rows(
    session: Session, caller: Caller, filters: SequenceFilters, query: PageQuery
) -> tuple[Sequence[Row[Any]], str | None]:
    """Return rows of `with_glances`, and the cursor of the next page. Raises `bad_cursor`."""
    wanted = filters.wanted
    kept = _kept_sequences(caller.is_administrator, tuple(wanted), form_of(query))
    given = {"caller": caller.user_id, **{f"wanted_{key}": value for key, value in wanted.items()}}
    return page_of(kept.rows(session, {**given, **page_values(query)}), query)


@lru_cache(MOST_FORMS)
def _kept_sequences(is_administrator: bool, wanted: tuple[str, ...], form: PageForm) -> KeptSelect:
    """Return the cached statement of a page with these filters for this kind of caller."""
    caller = None if is_administrator else parameter("caller")
    named = {key: parameter(f"wanted_{key}") for key in wanted}
    page = newest_page(narrowed_by(sequences_shown(caller), named), SequenceRow.id, form)
    return KeptSelect(with_glances(page, caller))
