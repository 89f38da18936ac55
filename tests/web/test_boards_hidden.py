"""What a page tells of a phase whose ground truth is hidden: what the policy lets through, and nothing in the markup.

**Conventions.** Judged are the bytes of the page, since a figure tells by its geometry what its text leaves out: no
digits of an exact total beyond the rounded ones, no bound of an interval, no part of a breakdown, no count. That the
same search finds them where they are shown proves that it can. Instants are left out: once in a while 49.22 s past the
minute is also a figure.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass

import httpx
import pytest

from services.runtime.access import sessions
from services.runtime.orm import Benchmark, User
from services.runtime.platform import Platform
from stone.scoring.metric import RATIOS
from testing.api.serving import Person, person, serving
from tests.web.boards_world import Season, season
from web.main import make_site

RIVAL = "VoxTrav"
INSTANT = re.compile(r"\d{4}-\d\d-\d\dT\d\d(?::|%3A)\d\d(?::|%3A)\d\d(?:\.\d+)?Z")


@dataclass(frozen=True)
class Reading:
    """Pages as bytes, over HTTP, as a browser asks for them."""

    world: Season
    client: httpx.Client
    administrator: dict[str, str]
    member: dict[str, str]

    def pages(self, cookie: dict[str, str] | None = None) -> str:
        """All sections of the benchmark, the method's page and the comparison, one after the other."""
        world = self.world
        compared = f"{world.path}/compare?a={world.mine}&b={world.entries[RIVAL]}"
        sections = [f"{world.path}/{one}" for one in ("data", "rules", "submit")]
        sections += [f"/benchmarks/{world.benchmark}", world.path, f"/entries/{world.mine}", compared]
        return "".join(self.page(path, cookie) for path in sections)

    def page(self, path: str, cookie: dict[str, str] | None = None) -> str:
        answer = self.client.get(path, headers={"Accept": "text/html", **(cookie or {})})
        assert answer.status_code == 200, answer.text[:500]
        return answer.text

    def secrets(self) -> dict[str, str]:
        """What a page must not hold while the truth is hidden, by what it is."""
        record = self.world.at.score_row(self.world.mine).record
        bounds = record["intervals"]["these_places"]
        exact = {f"exact {name}": f"{record['total'][name]:.8f}"[2:9] for name in RATIOS}
        ends = {f"{name} {end}": f"{100 * bounds[name][end]:.2f}" for name in RATIOS for end in (0, 1)}
        parts = {f"of {name}": f"{100 * part['miou']:.2f}" for name, part in record["by"]["sequence"].items()}
        counts = {f"count {n}": f"{n:,}" for row in record["confusion"] for n in row if n}
        ids = (self.world.mine, *self.world.entries.values())
        totals = [self.world.at.score_row(one).record["total"].values() for one in ids]
        shown = {f"{100 * ratio:.2f}" for of_entry in totals for ratio in of_entry if ratio}
        kept = {what: digits for what, digits in (ends | parts).items() if digits not in shown}
        return exact | kept | counts


@pytest.fixture
def reading(platform: Platform) -> Iterator[Reading]:
    world = season(platform)
    world.at.hide()
    administrator = person(platform, "administrator")
    with serving(platform, make_site(platform)) as url, httpx.Client(base_url=url, timeout=300.0) as client:
        yield Reading(world, client, _cookie(platform, administrator), _cookie(platform, world.member))


def _cookie(platform: Platform, who: Person) -> dict[str, str]:
    with platform.database.transaction() as session:
        opened = sessions.open_session(session, session.get_one(User, who.user_id), 3600.0)
    return {"Cookie": f"stone_session={opened.secret}"}


def told(secrets: dict[str, str], html: str) -> set[str]:
    """Which of the secrets stand in the page, as whole numbers or the beginnings of longer ones."""
    judged = INSTANT.sub("", html)
    return {what for what, digits in secrets.items() if re.search(rf"(?<![0-9]){re.escape(digits)}", judged)}


def test_neither_a_visitor_nor_the_team_reads_a_figure_that_is_hidden(reading: Reading) -> None:
    for cookie in (None, reading.member):
        html = reading.pages(cookie)
        assert "GroundNet++" in html
        assert told(reading.secrets(), html) == set()
        for words in ('class="span"', "By sequence", "By environment", 'class="matrix"', "these sequences</li>"):
            assert words not in html
        assert "until then its ground truth is hidden" in html


def test_the_rounded_total_and_the_rank_are_shown_while_the_rest_is_hidden(reading: Reading) -> None:
    miou = reading.world.at.score_row(reading.world.mine).record["total"]["miou"]
    assert f"{100 * round(miou, 4):.2f}" in reading.page(reading.world.path)
    assert "do not differ significantly from the first in the bracket" in reading.page(reading.world.path)


def test_an_administrator_reads_what_others_do_not(reading: Reading) -> None:
    seen = told(reading.secrets(), reading.pages(reading.administrator))
    assert {what for what in reading.secrets() if not what.startswith("exact")} <= seen


def test_when_the_phase_has_ended_everybody_reads_it(reading: Reading) -> None:
    reading.world.at.end()
    html = reading.pages()
    seen = told(reading.secrets(), html)
    assert {what for what in reading.secrets() if not what.startswith("exact")} <= seen
    assert "By environment" in html


def test_until_names_are_told_pages_hold_no_team_and_no_description(reading: Reading) -> None:
    reading.world.at.hide(named_from_ns=2**62)
    html = reading.pages()
    assert "Terrain Gang" not in html
    assert "Sparse convolutions" not in html
    assert "team name hidden" in html
    assert "Terrain Gang" in reading.pages(reading.member)


def test_a_benchmark_that_is_not_public_shows_a_visitor_nothing(reading: Reading) -> None:
    with reading.world.at.platform.database.transaction() as session:
        session.query(Benchmark).filter_by(name=reading.world.benchmark).one().is_public = False
    world = reading.world
    for path in (world.path, f"/benchmarks/{world.benchmark}", f"/entries/{world.mine}", f"{world.path}/compare"):
        answer = reading.client.get(path, headers={"Accept": "text/html"})
        assert answer.status_code == 401, path
        assert "GroundNet++" not in answer.text
        assert reading.client.get(path, headers={"Accept": "text/html", **reading.member}).status_code == 200
    assert world.benchmark not in reading.page("/benchmarks")
