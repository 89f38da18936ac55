"""The catalogue of error types: what the `type` of a problem links to."""

from collections.abc import Iterator

from fastapi import APIRouter

from api.answers import refusals
from api.errors import NotFoundError
from api.problems import title_of
from api.schemas.audit import ProblemItem
from api.statuses import STATUS_OF, status_of
from stone.errors import StoneError

router = APIRouter(tags=["problems"])


@router.get("/problems", summary="List all problem types")
def kinds() -> list[ProblemItem]:
    leaves = {leaf for base in STATUS_OF for leaf in _leaves(base)}
    return [_kind(leaf) for leaf in sorted(leaves, key=lambda leaf: (status_of(leaf), leaf.code))]


@router.get("/problems/{code}", summary="Show one problem type", responses=refusals(404))
def kind(code: str) -> ProblemItem:
    for item in kinds():
        if item.code == code:
            return item
    raise NotFoundError("problem", code)


def _leaves(base: type[StoneError]) -> Iterator[type[StoneError]]:
    yield base
    for leaf in base.__subclasses__():
        yield from _leaves(leaf)


def _kind(leaf: type[StoneError]) -> ProblemItem:
    return ProblemItem(code=leaf.code, status=status_of(leaf), title=title_of(leaf))
