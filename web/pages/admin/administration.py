"""The administration's pages of jobs, queues and benchmarks, as one router."""

from api.noun_router import NounRouter
from web.pages.admin import benchmarks, job, jobs, phase, queues

router = NounRouter()
for one in (jobs, job, queues, benchmarks, phase):
    router.include_router(one.router)
