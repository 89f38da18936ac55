"""The catalogue of error types, which the `type` of a problem links to."""

from fastapi import APIRouter

from api.answers import refusals
from api.errors import NotFoundError
from api.paging import Page, whole
from api.schemas.audit import ProblemItem
from api.statuses import PROBLEM_TYPES
from stone_base.codes.renamed import RENAMED

router = APIRouter(tags=["problems"])


@router.get("/problems", summary="List all problem types")
def list_problems() -> Page[ProblemItem]:
    listed = sorted(PROBLEM_TYPES.items(), key=lambda one: (one[1].status, one[0]))
    return whole([ProblemItem(code=code, status=kind.status, title=kind.title) for code, kind in listed])


@router.get("/problems/{code}", summary="Show one problem type", responses=refusals(404))
def show_problem(code: str) -> ProblemItem:
    code = RENAMED.get(code, code)
    if code not in PROBLEM_TYPES:
        raise NotFoundError("problem", code)
    return ProblemItem(code=code, status=PROBLEM_TYPES[code].status, title=PROBLEM_TYPES[code].title)
