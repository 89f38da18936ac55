"""The administration's pages of jobs, queues and benchmarks, as one router."""

from fastapi import APIRouter

from web.pages import admin_benchmarks, admin_job, admin_jobs, admin_phase, admin_queues

router = APIRouter()
for one in (admin_jobs, admin_job, admin_queues, admin_benchmarks, admin_phase):
    router.include_router(one.router)
