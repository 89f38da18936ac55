"""Renders a page from a template, with its caller, its content and its content security policy.

**Conventions.** Templates escape all strings except our own import map. Pages contain no `style` attributes, which the
policy forbids: lengths from data are SVG attributes. Times are written in the reader's zone from the cookie of
`web/zones.py`, which `modules/times.ts` sets; without it in UTC, and the module rewrites them.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fastapi import Request
from fastapi.responses import HTMLResponse
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from api.deps import VISITOR, Caller, platform_of
from api.views.people import sign_in_ways
from services.domain.sequences.label_choices import BOUNDS, DEFAULT_PROFILE, default_of
from stone_base.codes.catalogue import CATALOGUE, harm_of
from stone_base.codes.meaning import HARM_WORDS
from stone_base.label_grid import GRIDS
from web import words
from web.assets import Assets
from web.words import colours_of
from web.zones import zone_of

TEMPLATES = Path(__file__).parent / "templates"
POLICY = (
    "default-src 'none'; script-src 'self' '{import_map}'{more}; style-src 'self'; img-src 'self' data: blob:; "
    "connect-src 'self'; worker-src 'self'; media-src 'self'; font-src 'self'; form-action 'self'; base-uri 'none'; "
    "frame-ancestors 'none'"
)
WITH_WASM = " 'wasm-unsafe-eval'"
"""Added to `script-src` where a module counts hashes by WebAssembly."""


@dataclass(frozen=True)
class Nav:
    """A link of the head of every page, which `roles` may see; it is marked on pages below it and below `also`."""

    title: str
    path: str
    roles: tuple[str, ...] = ()
    also: tuple[str, ...] = ()

    def holds(self, path: str) -> bool:
        """Return whether the page belongs to this link."""
        return path.startswith((self.path.rsplit("/", 1)[0] or self.path, *self.also))


NAVIGATION = (
    Nav("Sequences", "/sequences", also=("/calibrations", "/imports")),
    Nav("Benchmarks", "/benchmarks", also=("/entries",)),
    Nav("Dataset", "/dataset", ("participant", "curator", "administrator")),
    Nav("Submissions", "/submissions", ("participant", "curator", "administrator"), also=("/teams",)),
    Nav("Administration", "/admin/jobs", ("administrator",)),
)


class PageTemplates:
    """The templates of one process, and what they load."""

    def __init__(self, assets: Assets) -> None:
        self.assets = assets
        self._templates = Environment(
            loader=FileSystemLoader(TEMPLATES),
            autoescape=True,
            undefined=StrictUndefined,
            trim_blocks=True,
            lstrip_blocks=True,
        )
        self._templates.globals |= {
            "asset": assets.url,
            "import_map": Markup(assets.import_map),
            "label_bounds": BOUNDS,
            "label_default": default_of,
            "default_profile": DEFAULT_PROFILE,
            "label_grids": GRIDS,
            "meaning_of": CATALOGUE.get,
            "harm_of": harm_of,
            "harm_words": HARM_WORDS,
        }
        self._templates.filters |= words.FILTERS
        self._templates.tests |= words.TESTS

    def render(self, template: str, **values: Any) -> str:
        return self._templates.get_template(template).render(**values)


def page(
    request: Request, caller: Caller, template: str, *, status: int = 200, needs_wasm: bool = False, **values: Any
) -> HTMLResponse:
    """Return the rendered template with `values`, `me`, `path`, `query`, `zone`, `colours`, `ways`, `navigation`."""
    pages: PageTemplates = request.app.state.pages
    known = {
        "me": caller,
        "path": request.url.path,
        "query": request.query_params,
        "zone": zone_of(request),
        "ways": sign_in_ways(platform_of(request).settings),
        "colours": colours_of(request),
        "navigation": [nav for nav in NAVIGATION if not nav.roles or caller.role in nav.roles],
    }
    content = pages.render(template, **known | values)
    policy = POLICY.format(import_map=pages.assets.import_map_hash, more=WITH_WASM if needs_wasm else "")
    headers = {"Content-Security-Policy": policy, "Cache-Control": "private, no-cache"}
    return HTMLResponse(content, status, headers=headers)


def caller_of(request: Request) -> Caller:
    """Return the caller of a public page, if already identified."""
    caller: Caller | None = getattr(request.state, "caller", None)
    return caller or VISITOR
