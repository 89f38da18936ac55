"""Every link of every page leads somewhere, for everybody who is shown it; and every page is whole by axe's rules.

Catches alone a link, or a fault against axe's rules, on a page that no other test opens.
"""

from collections.abc import Iterator

import httpx
import pytest
from sqlalchemy import select

from services.runtime.orm import Benchmark, SequenceRow
from services.runtime.platform import Platform
from testing.api.serving import Person, serving
from testing.web.browsing import Site
from testing.web.crawling import crawled
from testing.worlds import made
from testing.worlds.benchmark_world import World, benchmark_world, run_eval
from testing.worlds.sending import guess, send, zipped
from tests.api.inputs_made import made_input
from tests.web.looking import serious_findings
from tests.web.test_pages_access import cookie
from web.main import make_site

pytestmark = pytest.mark.whole

WHO = ("visitor", "participant", "curator", "administrator")


@pytest.fixture
def world(platform: Platform) -> World:
    """A public benchmark with a scored entry and a baseline, a public sequence with an export, inputs of a phase."""
    world = benchmark_world(platform)
    send(world, zipped(world, guess(world)))
    send(world, zipped(world, guess(world, turn=1)), kind="baseline", team=1)
    run_eval(platform)
    name = next(iter(world.grids["val"]))
    made_input(platform, world.val, name, {"sample.json": b"[]"})
    with platform.database.transaction() as session:
        session.scalars(select(Benchmark)).one().is_public = True
        sequence = session.scalars(select(SequenceRow).where(SequenceRow.name == name)).one()
        sequence.is_public = True
        sequence_id = sequence.id
    made.export(platform, sequence_id, {"mesh.ply": b"ply"})
    return world


def person_of(world: World, who: str) -> Person | None:
    people = {"participant": world.captains[0], "curator": world.curator, "administrator": world.administrator}
    return people.get(who)


@pytest.fixture
def client(world: World) -> Iterator[httpx.Client]:
    with serving(world.platform, make_site(world.platform)) as url, httpx.Client(base_url=url, timeout=300) as client:
        yield client


@pytest.mark.parametrize("who", WHO)
def test_no_link_leads_nowhere(client: httpx.Client, world: World, who: str) -> None:
    person = person_of(world, who)
    headers = {} if person is None else cookie(world.platform, person)
    found = list(crawled(client, headers))
    assert [one for one in found if one.status >= 400] == []
    assert {one.path for one in found} >= {"/", "/sequences", "/benchmarks"}


@pytest.mark.parametrize("who", ["curator", "administrator"])
def test_axe_finds_nothing_serious_on_any_page(site: Site, world: World, who: str) -> None:
    person = person_of(world, who)
    assert person is not None
    with httpx.Client(base_url=site.url, timeout=300) as client:
        found = list(crawled(client, cookie(world.platform, person)))
    pages = {one.shape: one.path for one in found if one.is_page}
    serious = {}
    with site.visit(person) as page:
        for shape, path in pages.items():
            page.goto(path)
            if findings := serious_findings(page):
                serious[shape] = findings
    assert serious == {}
