"""The site: the API, and pages for people on top of it.

**Conventions.** The API works without the pages. Pages change data only through the API's own routes, so that each
action has one implementation, one access check and one audit line. Pages read data through the functions of the API's
routes. Pages live at the root, the API under `/api/v1`, static files under `/assets`.
"""

from fastapi import APIRouter, FastAPI

from api.main import configure_process, include, make_api
from services.runtime.platform import Platform, open_platform
from services.runtime.settings import Settings
from services.runtime.telemetry.log_lines import speak_json
from web import assets, faults
from web.pages import (
    audit,
    benchmark_sections,
    benchmarks,
    boards,
    calibrations,
    codes,
    comparison,
    dataset,
    device,
    docs,
    downloads,
    help,
    home,
    imports,
    methods,
    people,
    sequence,
    sequence_own,
    sequences,
    sign_in,
    splits,
    submission_form,
    submissions,
    teams,
    viewer,
)
from web.pages.admin import benchmarks as admin_benchmarks
from web.pages.admin import durations as admin_durations
from web.pages.admin import jobs as admin_jobs
from web.pages.admin import phase as admin_phase
from web.rendering import PageTemplates

ROUTERS: tuple[APIRouter, ...] = (
    assets.router,
    home.router,
    sign_in.router,
    downloads.router,
    docs.router,
    help.router,
    device.router,
    admin_jobs.router,
    admin_durations.router,
    admin_benchmarks.router,
    admin_phase.router,
    calibrations.router,
    codes.router,
    imports.router,
    sequences.router,  # before a sequence's own page, which would match `new` as an id
    viewer.router,
    benchmarks.router,
    benchmark_sections.router,
    boards.router,
    comparison.router,
    methods.router,
    dataset.router,
    splits.router,
    people.router,
    audit.router,
    submissions.router,
    submission_form.router,
    teams.router,
    sequence.router,
    sequence_own.router,
)


def make_site(platform: Platform) -> FastAPI:
    """Return the API of this platform with its pages. Raises `pages_not_built`."""
    site = make_api(platform, faults.shown)
    site.state.pages = PageTemplates(assets.built_assets())
    for router in ROUTERS:
        include(site, router, include_in_schema=False)
    return site


def from_environment() -> FastAPI:
    """Return the site of this process: `uvicorn --factory web.main:from_environment`; `--http`: see
    `middleware/heads.py`.
    """
    speak_json()
    return configure_process(make_site(open_platform(Settings())))
