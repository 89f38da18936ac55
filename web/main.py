"""The site: the API, and pages for people on top of it.

**Conventions.** The API works without the pages; a page changes nothing but through the API's own routes, so that there
is one way to do a thing, one check of who may, and one line in the audit log. What pages show comes from the functions
that the API's routes answer with. Pages live at the root, the API under `/api/v1`, what browsers load under `/assets`.
"""

from fastapi import APIRouter, FastAPI

from api.main import make_api, told
from services.runtime.log_lines import speak_json
from services.runtime.platform import Platform, open_platform
from services.runtime.settings import Settings
from web import assets, faults
from web.pages import (
    administration,
    audit,
    benchmarks,
    boards,
    calibrations,
    comparing,
    dataset,
    home,
    methods,
    people,
    sequence,
    sequence_own,
    sequences,
    signing_in,
    splits,
    submissions,
    submitting,
    teams,
    viewer,
)
from web.rendering import Pages

ROUTERS: tuple[APIRouter, ...] = (
    assets.router,
    home.router,
    signing_in.router,
    administration.router,
    calibrations.router,
    sequences.router,  # before a sequence's own page, which would take `new` for an id
    viewer.router,
    benchmarks.router,
    boards.router,
    comparing.router,
    methods.router,
    dataset.router,
    splits.router,
    people.router,
    audit.router,
    submissions.router,
    submitting.router,
    teams.router,
    sequence.router,  # after all that is below /sequences by a word: `new` is no id
    sequence_own.router,
)


def make_site(platform: Platform) -> FastAPI:
    """The API of this platform with its pages. Raises `PagesNotBuiltError`."""
    site = make_api(platform, faults.shown)
    site.state.pages = Pages(assets.built_assets())
    for router in ROUTERS:
        site.include_router(router, include_in_schema=False)
    return site


def from_environment() -> FastAPI:
    """The site of this process: `uvicorn --factory web.main:from_environment --http api.heads:BoundedHeads`."""
    speak_json()
    return told(make_site(open_platform(Settings())))
