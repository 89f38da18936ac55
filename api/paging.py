"""Cursor pagination: stable pages while rows are added and deleted.

**Conventions.** The order column is unique and not null (an id). A cursor is opaque: base64url of the JSON of the last
row's value in that column. It grants no access, because every page runs the list's own query. An invalid cursor returns
422.
"""

import json
from base64 import urlsafe_b64decode, urlsafe_b64encode
from binascii import Error as Base64Error
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Generic, TypeVar

from fastapi import Depends, Query
from pydantic import BaseModel, Field
from sqlalchemy import Select, UnaryExpression
from sqlalchemy.orm import InstrumentedAttribute, Session
from sqlalchemy.sql.operators import desc_op

from api.errors import bad_cursor

T = TypeVar("T")
Row = TypeVar("Row")

MOST = 200
LONGEST_CURSOR = 512
LARGEST = 2**63 - 1


@dataclass(frozen=True)
class PageQuery:
    """The requested page."""

    cursor: str | None
    limit: int


async def page_query(
    cursor: Annotated[str | None, Query(max_length=LONGEST_CURSOR, description="`next` of the previous page.")] = None,
    limit: Annotated[int, Query(ge=1, le=MOST, description="Maximum number of items in the response.")] = 50,
) -> PageQuery:
    return PageQuery(cursor, limit)


PageDep = Annotated[PageQuery, Depends(page_query)]


class Page(BaseModel, Generic[T]):
    """A part of a list; `next` is the cursor of the next page, null at the end."""

    items: list[T]
    next: str | None = Field(default=None, examples=["IjAxOTNhZjAwIg"])


def whole(items: Sequence[T]) -> Page[T]:
    """Return a short list as its only page."""
    return Page[Any](items=list(items))


@dataclass(frozen=True)
class PageRows(Generic[Row]):
    """The rows of a page and the cursor of the next page."""

    rows: Sequence[Row]
    next: str | None

    def shown(self, as_body: Callable[[Row], T]) -> Page[T]:
        """Return the page with every row converted to its response body."""
        return Page[Any](items=[as_body(row) for row in self.rows], next=self.next)


def page(
    session: Session,
    statement: Select[Row],
    order: InstrumentedAttribute[Any] | UnaryExpression[Any],
    query: PageQuery,
) -> PageRows[Row]:
    """Return one page of `statement`, ordered by the unique column `order` (`Sequence.id`, or `Sequence.id.desc()`).

    Raises `bad_cursor`.
    """
    is_falling = isinstance(order, UnaryExpression) and order.modifier is desc_op
    column: Any = order.element if isinstance(order, UnaryExpression) else order
    if query.cursor is not None:
        last = last_of(query.cursor, column.type.python_type)
        statement = statement.where(column < last if is_falling else column > last)
    fetched = session.scalars(statement.order_by(None).order_by(order).limit(query.limit + 1)).all()
    rows = fetched[: query.limit]
    is_last = len(fetched) <= query.limit
    return PageRows(rows, None if is_last else cursor_after(getattr(rows[-1], column.key)))


def place_of_page(total: int, query: PageQuery) -> tuple[range, str | None]:
    """Return which of `total` items in a fixed order are on the page, and the cursor of the next page.

    Raises `bad_cursor`.
    """
    last = -1 if query.cursor is None else int(str(last_of(query.cursor, int)))
    if last < -1:
        raise bad_cursor()
    places = range(min(last + 1, total), min(last + 1 + query.limit, total))
    return places, cursor_after(places[-1]) if places and places.stop < total else None


def cursor_after(value: object) -> str:
    """Return the cursor of the page after this value."""
    return urlsafe_b64encode(json.dumps(value).encode()).decode().rstrip("=")


def last_of(cursor: str, kind: type) -> object:
    """Return the value that a cursor starts after. Raises `bad_cursor` if it is not of this kind."""
    try:
        padded = cursor.encode("ascii") + b"=" * (-len(cursor) % 4)
        value = json.loads(urlsafe_b64decode(padded))
    except (Base64Error, ValueError, RecursionError) as error:
        raise bad_cursor() from error
    if type(value) is not kind or not _is_storable(value):
        raise bad_cursor()
    return value


def _is_storable(value: object) -> bool:
    """Return whether both databases accept the value: no NUL, no lone surrogate, no integer beyond 64 bits."""
    return abs(value) <= LARGEST if isinstance(value, int) else str(value).isprintable()
