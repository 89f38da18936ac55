"""The administration's pages of jobs, queues and benchmarks, as one router."""

from fastapi import APIRouter

from web.pages import admin_job, admin_jobs, admin_queues

router = APIRouter()
for one in (admin_jobs, admin_job, admin_queues):
    router.include_router(one.router)
