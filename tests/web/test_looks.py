"""Every page as people look at it, once for each template: light, dark, on a phone, by axe; and every link of each.

**Conventions.** One world that has something for every page. Pages are found by following links, as each role; of those
that a template makes, the one with the most on it is looked at. A template that no link leads to fails.

Catches alone a link that leads nowhere, a fault against axe's rules, and what is wider than a phone.
"""

import re
import shutil
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import pytest
from fastapi import FastAPI
from fastapi.routing import iter_route_contexts
from playwright.sync_api import Browser, Page, expect
from sqlalchemy import select

from services.runtime.orm import Benchmark, Job, LabelSet, SequenceRow, SubmissionRow
from services.runtime.platform import Platform
from simulator.pipeline import calibration_path
from testing.api.serving import Person, serving
from testing.servers.fixtures import make_settings, opened
from testing.web.browsing import Site
from testing.web.crawling import Found, crawled
from testing.web.signed_in import cookie
from testing.worlds import made
from testing.worlds.benchmark_world import World, benchmark_world, run_eval
from testing.worlds.brought_datasets import bring_dataset
from testing.worlds.published_datasets import SyntheticDataset, made_labels, write_published_tar
from testing.worlds.sending import guess, pair_of, send, zipped
from tests.api.inputs_made import made_input
from tests.web.bringing import bag
from tests.web.looking import look
from tests.web.sequence_world import ASKED, playback, whole_sequence
from web.main import make_site
from web.pages import docs
from web.rendering import TEMPLATES

pytestmark = pytest.mark.whole

WHO = ("visitor", "participant", "curator", "administrator")
OF_A_PAGE = re.compile(r'{% extends "(base|sequence/base)\.html" %}')
TEMPLATES_OF_PAGES = sorted(
    path.relative_to(TEMPLATES).as_posix() for path in TEMPLATES.rglob("*.html") if OF_A_PAGE.match(path.read_text())
)
NOT_LINKED = ("/device", "/nothing-here", "/docs/", "/dataset/new", "/imports", "/teams", "/calibrations")
SMALL_TAR = SyntheticDataset(scenes=1, cameras=("CAM_FRONT",), labels=[made_labels()])


@dataclass
class Stand:
    """The world, its site, and which templates it has rendered, in their order."""

    world: World
    application: FastAPI
    url: str
    rendered: list[str] = field(default_factory=list)
    found: dict[str, list[Found]] = field(default_factory=dict)
    pages: dict[str, tuple[int, str, str]] = field(default_factory=dict)
    """Of each template the size, the reader and the path of the page with the most on it."""

    def person_of(self, who: str) -> Person | None:
        world = self.world
        people = {"participant": world.captains[0], "curator": world.curator, "administrator": world.administrator}
        return people.get(who)

    def comparison(self) -> str:
        """The page that a form of the board leads to."""
        with self.world.platform.database.reading() as session:
            a, b = session.scalars(select(SubmissionRow.id).where(SubmissionRow.kind == "entry")).all()
        return f"/benchmarks/{self.world.benchmark}/val/compare?a={a}&b={b}"

    def crawl(self, who: str) -> None:
        headers = cookie(self.world.platform, self.person_of(who))
        self.found[who] = []
        with httpx.Client(base_url=self.url, timeout=300) as client:
            for start in ("/", *NOT_LINKED, self.comparison()):
                before = len(self.rendered)
                for one in crawled(client, headers, start) if start == "/" else [visited(client, headers, start)]:
                    self.found[who] += [one] if start == "/" else []
                    seen = (len(one.html), who, one.path)
                    for template in self.rendered[before:]:
                        self.pages[template] = max(self.pages.get(template, (0, "", "")), seen)
                    before = len(self.rendered)


def visited(client: httpx.Client, headers: dict[str, str], path: str) -> Found:
    answer = client.get(path, headers={"Accept": "text/html", **headers})
    return Found(path, path, "", answer.status_code, answer.text)


def populate(platform: Platform, folder: Path) -> World:
    """A public benchmark with scored entries and inputs, sequences of all kinds, an import."""
    world = benchmark_world(platform, frames=2)
    for team in (0, 1):
        send(world, zipped(world, guess(world, turn=team)), team=team)
    send(world, zipped(world, guess(world, turn=2)), kind="baseline", team=1)
    run_eval(platform)
    name = next(iter(world.grids["val"]))
    made_input(platform, world.val, name, {"sample.json": b"[]"})
    facts = whole_sequence(platform, world.curator)
    playback(platform, facts)
    made.export(platform, facts["id"], {"mesh.ply": b"ply"})
    bring_dataset(platform, write_published_tar(folder / "field.tar", SMALL_TAR), world.curator.user_id)
    with platform.database.transaction() as session:
        session.scalars(select(Benchmark)).one().is_public = True
        run = session.get_one(Job, session.get_one(LabelSet, facts["label_set_id"]).job_id)
        run.arguments = {**run.arguments, **ASKED, "recording_ids": [facts["recording_id"]]}
        for row in session.scalars(select(SequenceRow).where(SequenceRow.name.in_([name, facts["name"]]))):
            row.is_public = True
    return world


def ask(stand: Stand) -> None:
    """What is made by the API itself."""
    world = stand.world
    with httpx.Client(base_url=stand.url, timeout=300) as api:
        file = {"file": ("rig.yaml", calibration_path(bag()).read_bytes())}
        answers = [api.post("/api/v1/calibrations", files=file, headers=world.curator.headers)]
        asked = {"truth_id": pair_of(world, "val").truth_id, "metric": "stone-iou-occupied-2", "reason": "to compare"}
        rescores = f"/api/v1/admin/phases/{world.val}/rescores"
        answers.append(api.post(rescores, json=asked, headers=world.administrator.headers))
        made.sequence(api, world.curator, "only-a-name")
    assert [answer.status_code for answer in answers] == [201, 202], [answer.text for answer in answers]


@pytest.fixture(scope="module")
def stand(tmp_path_factory: pytest.TempPathFactory, _sqlite_template: Path) -> Iterator[Stand]:
    folder = tmp_path_factory.mktemp("looks")
    settings = make_settings(folder)
    settings.root.mkdir(parents=True)
    shutil.copyfile(_sqlite_template, settings.root / "stone.sqlite3")
    platform = opened(settings, [])
    application = make_site(platform)
    with pytest.MonkeyPatch.context() as patch, serving(platform, application) as url:
        patch.setattr(docs, "MANUAL", folder / "none")
        stand = Stand(populate(platform, folder), application, url)
        render = application.state.pages.render

        def noted(template: str, **values: Any) -> str:
            stand.rendered.append(template)
            return str(render(template, **values))

        patch.setattr(application.state.pages, "render", noted)
        ask(stand)
        for who in WHO:
            stand.crawl(who)
        yield stand
    platform.database.close()


@pytest.fixture(scope="module")
def page_of(stand: Stand, browser: Browser) -> Iterator[dict[str, Page]]:
    """A page of each role's own browser; what no page may do is checked at the end."""
    site = Site(stand.url, stand.world.platform, browser)
    with ExitStack() as open_pages:
        yield {
            who: open_pages.enter_context(site.visit(stand.person_of(who), expected=["401", "403", "404"]))
            for who in WHO
        }


@pytest.mark.parametrize("who", WHO)
def test_no_link_leads_nowhere(stand: Stand, who: str) -> None:
    assert [one for one in stand.found[who] if one.status >= 400] == []
    assert {one.path for one in stand.found[who]} >= {"/", "/sequences", "/benchmarks"}


def test_every_form_that_acts_and_every_part_that_is_followed_has_a_route(stand: Stand) -> None:
    """Catches alone a form whose address no route of the API has."""
    asked = set()
    for one in (one for who in WHO for one in stand.found[who]):
        asked |= set(re.findall(r'data-act="(\w+) (/[^"?]+)', one.html))
        asked |= {("GET", path) for path in re.findall(r'data-(?:follow|log)="(/[^"?]+)', one.html)}
    assert len(asked) > 40
    routes = [
        (method, re.compile(re.sub(r"\{[^}]*\}", "[^/]+", route.path)))
        for route in iter_route_contexts(stand.application.routes)
        for method in route.methods or ()
        if route.path
    ]
    lost = {one for one in asked if not any(one[0] == method and at.fullmatch(one[1]) for method, at in routes)}
    assert lost == set()


@pytest.mark.parametrize("template", [name for name in TEMPLATES_OF_PAGES if name != "sequence/base.html"])
def test_a_page_is_whole_in_light_dark_and_on_a_phone(stand: Stand, page_of: dict[str, Page], template: str) -> None:
    _, who, path = stand.pages[template]
    page = page_of[who]
    page.goto(path)
    if page.locator("[data-viewer]").count():
        expect(page.locator("[data-viewer]").first).to_have_attribute("data-state", re.compile("ready|empty|picture"))
    look(page, template.removesuffix(".html").replace("/", "-"))
