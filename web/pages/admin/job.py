"""A job or run as its administrator sees it, at `/admin/jobs/{id}`: stages along time, attempts, log lines."""

from fastapi import Request
from fastapi.responses import HTMLResponse

from api.deps import Administrator, PlatformDep
from api.noun_router import NounRouter
from api.schemas.base import IdPath
from api.views.admin import admin_job_detail, job_spans_of
from api.views.jobs import job_items
from api.visible import job_of
from services.runtime.jobs.specs import TERMINAL
from services.runtime.orm import Job
from services.runtime.orm.base import now_ns
from web.rendering import page
from web.stage_picture import stage_picture

router = NounRouter()


@router.get("/admin/jobs/{job_id}")
def job(job_id: IdPath, request: Request, caller: Administrator, platform: PlatformDep) -> HTMLResponse:
    with platform.database.reading() as session:
        row = job_of(session, caller, job_id)
        detail = admin_job_detail(session, row)
        spans = job_spans_of(session, row) if row.id == row.root_id else []
        root = session.get_one(Job, row.root_id)
        (run,) = job_items(session, [root])
    return page(
        request,
        caller,
        "admin/job.html",
        job=detail,
        root=root,
        run=run,
        picture=stage_picture(spans, now_ns()),
        is_over=row.state in TERMINAL,
        is_root_over=root.state in TERMINAL,
    )
