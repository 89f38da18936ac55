"""Routes as somebody in a hurry would write them: each has one hole that the matrix must find.

**Conventions.** For a test-only application; `HOLES` is the table of expectations such routes ought to meet.
"""

from fastapi import APIRouter, FastAPI
from sqlalchemy import select, update

from api.callers import Reader
from api.deps import PlatformDep
from api.errors import NotFoundError
from api.schemas.base import IdPath
from services.runtime.orm import CalibrationRow, SequenceRow

router = APIRouter(prefix="/api/v1/holes")

HOLES = """
                                               anon part owner other admin mod narr exp inact web forg
GET    /api/v1/holes/open/{sequence_id}         401  404  200   404   200  404 403  401  401  200 200
GET    /api/v1/holes/unowned/{sequence_id}      401  404  200   404   200  404 403  401  401  200 200
GET    /api/v1/holes/list                       401  200  200   200   200  200 403  401  401  200 200
GET    /api/v1/holes/telling/{sequence_id}      401  404  404   404   404  404 403  401  401  404 404
DELETE /api/v1/holes/writing/{sequence_id}      401  404  404   404   404  404 403  401  401  404 403
"""


@router.get("/open/{sequence_id}")
def without_its_dependency(sequence_id: IdPath, platform: PlatformDep) -> str:
    with platform.database.reading() as session:
        return session.get_one(SequenceRow, sequence_id).environment


@router.get("/unowned/{sequence_id}")
def without_asking_whose(sequence_id: IdPath, _caller: Reader, platform: PlatformDep) -> str:
    with platform.database.reading() as session:
        return session.get_one(SequenceRow, sequence_id).environment


@router.get("/list")
def lists_everybodys(_caller: Reader, platform: PlatformDep) -> list[str]:
    with platform.database.reading() as session:
        return list(session.scalars(select(CalibrationRow.id)))


@router.get("/telling/{sequence_id}")
def tells_that_it_exists(sequence_id: IdPath, _caller: Reader, platform: PlatformDep) -> None:
    with platform.database.reading() as session:
        is_known = session.get(SequenceRow, sequence_id) is not None
    raise NotFoundError("sequence of yours" if is_known else "sequence", sequence_id)


@router.delete("/writing/{sequence_id}")
def refuses_after_writing(sequence_id: IdPath, _caller: Reader, platform: PlatformDep) -> None:
    with platform.database.transaction() as session:
        session.execute(update(SequenceRow).where(SequenceRow.id == sequence_id).values(region="moved"))
    raise NotFoundError("sequence", sequence_id)


def with_holes(application: FastAPI) -> FastAPI:
    application.include_router(router)
    return application
