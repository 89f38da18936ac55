"""The answer of a list: its rows as JSON, with a tag by which whoever has it already is told so.

**Conventions.** Items are dictionaries in the shape and the order of their schema (`tests/api/listed/` holds the
bytes). The ETag is of the very bytes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from fastapi import Request, Response
from pydantic import BaseModel
from pydantic_core import to_json
from sqlalchemy import Integer, Row, Select, literal_column
from sqlalchemy.orm import InstrumentedAttribute

from api.answers import Responses, refusals
from api.compression import tagged_response
from api.paging import PageQuery, cursor_after, last_of
from services.runtime.database.rows import Values, parameter

JSON_TYPE = "application/json"
MOST_FORMS = 500  # of a list's statement that are kept
Item = Mapping[str, Any]
T = TypeVar("T")


def listed(*statuses: int) -> Responses:
    """The responses of a list besides 200, and these refusals."""
    return {304: {"description": "The caller has it already"}, **refusals(*statuses)}


@dataclass(frozen=True)
class PageForm:
    """What of a page is part of its statement: whether it follows another one, and its length.

    A planner that does not know the length thinks of reading other tables whole.
    """

    goes_on: bool
    limit: int


def form_of(query: PageQuery) -> PageForm:
    return PageForm(query.cursor is not None, query.limit)


def newest_page(statement: Select[T], ids: InstrumentedAttribute[str], form: PageForm) -> Select[T]:
    """One page of it and a row more, the newest first: `page_values` are its values."""
    found = statement.where(ids < parameter("last")) if form.goes_on else statement
    return found.order_by(ids.desc()).limit(literal_column(str(form.limit + 1), Integer))


def page_values(query: PageQuery) -> Values:
    """The values of a page's statement, ordered by ids. Raises `BadCursorError`."""
    return {} if query.cursor is None else {"last": str(last_of(query.cursor, str))}


def page_of(rows: Sequence[Row[Any]], query: PageQuery) -> tuple[Sequence[Row[Any]], str | None]:
    """The rows of the page, of which one too many was asked for, and the cursor of the next one."""
    if len(rows) <= query.limit:
        return rows, None
    return rows[: query.limit], cursor_after(rows[query.limit - 1].id)


def list_response(request: Request, items: Sequence[Item], following: str | None) -> Response:
    """The page, or 304 to who has it already."""
    return tagged_response(request, to_json({"items": items, "next": following}), JSON_TYPE)


def model_response(request: Request, page: BaseModel) -> Response:
    """A page of models, written once: whatever a route returns as a model is checked and written by another thread."""
    return tagged_response(request, page.model_dump_json().encode(), JSON_TYPE)
