"""The administration's pages of jobs, queues and benchmarks, as one router."""

from api.noun_router import NounRouter
from web.pages.admin import benchmarks, jobs, phase

router = NounRouter()
for one in (jobs, jobs, jobs, benchmarks, phase):
    router.include_router(one.router)
