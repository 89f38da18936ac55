"""The administration's pages of jobs, queues and benchmarks, as one router."""

from fastapi import APIRouter

from web.pages.admin import benchmarks, job, jobs, phase, queues

router = APIRouter()
for one in (jobs, job, queues, benchmarks, phase):
    router.include_router(one.router)
