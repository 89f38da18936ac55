"""The board: ties, one axis, sorting as values of the page; its history, copies for papers and picks in a browser.

**Conventions.** Of a hidden ground truth the bytes of pages are judged, since a figure tells by its geometry what its
text leaves out: no digits of an exact total beyond the rounded ones, no bound of an interval, no part of a breakdown,
no count. That the same search finds them where they are shown proves that it can. Instants are left out: once in a
while 49.22 s past the minute is also a figure.
"""

import hashlib
import json
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect
from sqlalchemy import select

from services.runtime.orm import Activation, Benchmark, Dataset, Score
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from stone.scoring.metric import RATIOS
from testing.api.serving import Person, person
from testing.web.browsing import PHONE, Site
from testing.web.reading import Reading
from testing.worlds.benchmark_world import benchmark_world, run_eval
from testing.worlds.sending import guess, send, zipped
from tests.api.inputs_made import made_input, made_version_input
from tests.services.domain.benchmarks.boards import Made, scene
from tests.web.boards_world import Season, publish, season

METHODS = "tr[data-standing='ranked'] .method .row > :first-child"
IN_ORDER: list[str | re.Pattern[str]] = ["TerrainFormer-L", "GroundNet++", "VoxTrav", "SurroundOcc-T", "RadarScout"]
BACKGROUNDS = """row => [...row.querySelectorAll("th.method, td.number")].slice(0, 2).map(cell => {
  for (let one = cell; one; one = one.parentElement) {
    const colour = getComputedStyle(one).backgroundColor;
    if (!/, 0\\)$/.test(colour)) return colour;
  }
})"""


@pytest.fixture
def board(platform: Platform) -> Season:
    return season(platform)


def test_the_board_is_shown_as_it_stood_compared_and_copied_for_a_paper(site: Site, board: Season) -> None:
    with site.visit(permissions=["clipboard-read", "clipboard-write"]) as page:
        page.goto(board.path)
        expect(page.locator(METHODS)).to_have_text(IN_ORDER)
        assert r"\toprule" in copied(page)
        page.get_by_text("History", exact=True).click()
        slider = page.get_by_label("Leaderboard as of", exact=True)
        slider.focus()
        page.keyboard.press("Home")
        expect(page.locator(METHODS)).to_have_count(0)
        page.keyboard.press("ArrowRight")
        page.keyboard.press("ArrowRight")
        expect(page.locator(METHODS)).to_have_text(["RadarScout"])
        expect(page).to_have_url(re.compile("as_of="))
        expect(slider).to_be_focused()
        page.add_init_script("delete Navigator.prototype.clipboard")
        page.reload()
        expect(page.locator(METHODS)).to_have_text(["RadarScout"])
        assert "RadarScout" in copied(page)
        page.get_by_label("Leaderboard as of", exact=True).press("End")
        expect(page.locator(METHODS)).to_have_text(IN_ORDER)
        for method in ("RadarScout", "GroundNet++", "VoxTrav"):
            page.get_by_label(f"Compare {method}", exact=True).check()
        expect(page.get_by_label("Compare RadarScout")).not_to_be_checked()
        expect(page.locator("[data-picked]")).to_have_text("GroundNet++ against VoxTrav")
        page.get_by_role("button", name="Compare").click()
        expect(page).to_have_url(re.compile(f"a={board.mine}&b={board.entries['VoxTrav']}"))


def copied(page: Page) -> str:
    """What the clipboard holds once the table was copied: the file that the page links to."""
    page.get_by_role("button", name="Copy LaTeX").click()
    expect(page.locator("#toasts")).not_to_be_empty()
    page.evaluate("document.body.append(Object.assign(document.createElement('textarea'), {id: 'here'}))")
    page.locator("#here").press("Control+V")
    text = page.locator("#here").input_value()
    page.locator("#here").evaluate("here => here.remove()")
    assert text == page.request.get(page.locator("a", has_text="LaTeX").get_attribute("href") or "").text()
    return text


def test_on_a_phone_the_sticky_cell_is_highlighted_with_its_row(site: Site, board: Season) -> None:
    """Catches alone a highlight that stops at the cell which stays in view."""
    with site.visit(board.member, viewport=PHONE) as page:
        page.goto(board.path)
        plain = page.locator("tbody[data-standing='ranked'] tr:not(.is-yours)").last
        yours = page.locator("tr.is-yours").first
        for scheme in ("light", "dark"):
            page.emulate_media(color_scheme=scheme)  # type: ignore[arg-type]
            page.mouse.move(0, 0)
            resting = plain.evaluate(BACKGROUNDS)
            plain.locator(".method").hover()
            hovered, own = plain.evaluate(BACKGROUNDS), yours.evaluate(BACKGROUNDS)
            assert [len(set(cells)) for cells in (resting, hovered, own)] == [1, 1, 1], (resting, hovered, own)
            assert len({resting[0], hovered[0], own[0]}) == 3
        expect(page.locator("thead .danger")).to_have_text("Danger")
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth"), "only the table scrolls"


def order(html: str) -> list[str]:
    """The ranked methods in the order of the page."""
    ranked = html.partition('<tbody data-standing="ranked">')[2].partition("</tbody>")[0]
    names = [str(name) for name in IN_ORDER if f">{name}<" in ranked]
    return sorted(names, key=lambda name: ranked.index(f">{name}<"))


def test_the_board_has_ties_in_a_bracket_sorts_and_filters(reading: Reading, board: Season) -> None:
    html = reading.html(board.path)
    assert order(html) == IN_ORDER
    (tie,) = re.findall(r'<td class="[^"]*is-tied[^"]*" rowspan="(\d)"', html)
    assert tie == "2"
    for printed in ("24.3", "41.0", "31.0", "20.0", "22.0"):
        assert f">{printed}<" in html.partition('data-standing="reported"')[2], printed
    ceiling = html.partition('<tbody data-standing="ceiling">')[2].partition("</tbody>")[0]
    assert all(said in ceiling for said in ("the same drive labelled twice", ">78.1<", "no rank"))
    assert html.index('<tbody data-standing="ceiling">') < html.index('<tbody data-standing="ranked">')
    assert "no entry can be expected to score above it" in html
    assert '<span class="tag">ceiling</span>' in reading.html(f"/benchmarks/{board.benchmark}")
    extras = board.at.score_row(board.mine).record["extras"]
    mine = html.partition(f'value="{board.mine}"')[2].partition("</tr>")[0]
    assert mine.partition('danger">')[2].startswith(f"{100 * extras['n_predicted_drivable_ratio']:.2f}<")
    by_name = reading.html(f"{board.path}?sort=method")
    assert order(by_name) == sorted(map(str, IN_ORDER))
    assert "is-tied" not in by_name
    assert order(reading.html(f"{board.path}?track=R")) == ["RadarScout"]
    assert "is-yours" in reading.html(board.path, board.member)


def test_an_entry_has_its_parts_its_confusion_and_an_older_score_stays_readable(
    reading: Reading, board: Season
) -> None:
    entry = reading.html(f"/entries/{board.mine}", board.member)
    assert "&lt;b&gt;bold&lt;/b&gt;" in entry
    assert entry.count('class="heat') == 16
    assert f'href="/submissions/{board.mine}"' in entry
    pair = board.at.another_pair(now_ns())
    board.at.score(board.mine, Made(0.1, 2), pair)
    with board.at.platform.database.reading() as session:
        assert session.query(Activation).filter_by(phase_id=board.at.phase_id).count() == 2
        scores = select(Score.id).where(Score.submission_id == board.mine).order_by(Score.id)
        older, newer = session.scalars(scores).all()
    assert f"?score={older}" in reading.html(f"/entries/{board.mine}")
    assert reading.text(f"/entries/{board.mine}?score={older}") != reading.text(f"/entries/{board.mine}")
    assert reading.status(f"/entries/{board.mine}?score={newer}") == 200


def test_two_entries_are_ordered_alike_whichever_is_named_first(reading: Reading, board: Season) -> None:
    one, other = board.mine, board.entries["RadarScout"]
    for a, b in ((one, other), (other, one)):
        assert "GroundNet++ is better than RadarScout" in reading.text(f"{board.path}/compare?a={a}&b={b}")


def test_a_board_without_entries_is_a_page(reading: Reading, platform: Platform) -> None:
    name = publish(scene(platform))
    for section in ("", "/compare"):
        assert reading.status(f"/benchmarks/{name}/val{section}") == 200


SENSED = {"v1.0-trainval/sample.json": b"[]\n", "samples/LIDAR_TOP/0.bin": b"\x00" * 3000}


@pytest.mark.whole
def test_what_a_benchmark_gives_out_is_what_it_says_and_its_starter_script_makes_a_submission(
    reading: Reading, platform: Platform, tmp_path: Path
) -> None:
    """Catches alone a download of the pages that is not what it says, and a starter script whose zip is refused."""
    world = benchmark_world(platform, frames=2)
    captain = world.captains[1]
    send(world, zipped(world, guess(world)))
    send(world, zipped(world, guess(world, turn=2)), kind="baseline", team=1)
    hidden = send(world, zipped(world, guess(world, "test")), "test")
    run_eval(platform)
    name, of_train = (next(iter(world.grids[part])) for part in ("val", "train"))
    made_input(platform, world.val, name, SENSED)
    with platform.database.transaction() as session:
        session.scalars(select(Benchmark)).one().is_public = True
        dataset_id = session.scalars(select(Dataset.id)).one()
    version_input = made_version_input(platform, dataset_id, of_train, SENSED)
    page = reading.html(f"/benchmarks/{world.benchmark}/val/data", captain)
    links = dict(reversed(one) for one in re.findall(r'<a [^>]*href="([^"]+)"[^>]*>([^<]+)</a>', page))

    def fetched(path: str) -> bytes:
        answer = reading.answer(path.replace("&amp;", "&"), captain)
        assert answer.status_code == 200, path
        return answer.content

    manifest, starter = tmp_path / "val.json", tmp_path / "predict.py"
    manifest.write_bytes(fetched(links["Manifest"]))
    starter.write_bytes(fetched(links["predict.py"]))
    assert set(json.loads(manifest.read_text())["sequences"]) == set(world.grids["val"])
    assert hashlib.sha256(fetched(links[f"{name}.tar"])).hexdigest() in page
    (baseline,) = re.findall(r'href="([^"]+predictions\.zip)"', page)
    assert fetched(baseline) == zipped(world, guess(world, turn=2))
    archive = tmp_path / "run.zip"
    subprocess.run([sys.executable, starter, manifest, archive], check=True, timeout=120)
    assert send(world, archive.read_bytes(), team=1, kind="validation")
    run_eval(platform)
    page = reading.html(f"/benchmarks/{world.benchmark}/test/data", captain)
    (tar,) = re.findall(rf'href="([^"]+)"[^>]*>{of_train}\.tar<', page)
    assert hashlib.sha256(fetched(tar)).hexdigest() == version_input.tar[1]
    assert 'class="picture"' not in reading.html(f"/entries/{hidden}")


RIVAL = "VoxTrav"
INSTANT = re.compile(r"\d{4}-\d\d-\d\dT\d\d(?::|%3A)\d\d(?::|%3A)\d\d(?:\.\d+)?Z")


@dataclass(frozen=True)
class Hidden:
    """The pages of a season whose ground truth is hidden."""

    reading: Reading
    season: Season

    def pages(self, who: Person | None = None) -> str:
        """All sections of the benchmark, the method's page and the comparison, one after the other."""
        world = self.season
        compared = f"{world.path}/compare?a={world.mine}&b={world.entries[RIVAL]}"
        sections = [f"{world.path}/{one}" for one in ("data", "rules", "submit")]
        sections += [f"/benchmarks/{world.benchmark}", world.path, f"/entries/{world.mine}", compared]
        return "".join(self.reading.html(path, who) for path in sections)

    def secrets(self) -> dict[str, str]:
        """What a page must not hold while the truth is hidden, by what it is."""
        record = self.season.at.score_row(self.season.mine).record
        bounds = record["intervals"]["these_places"]
        exact = {f"exact {name}": f"{record['total'][name]:.8f}"[2:9] for name in RATIOS}
        ends = {f"{name} {end}": f"{100 * bounds[name][end]:.2f}" for name in RATIOS for end in (0, 1)}
        parts = {f"of {name}": f"{100 * part['miou']:.2f}" for name, part in record["by"]["sequence"].items()}
        parts["danger"] = f"{100 * record['extras']['n_predicted_drivable_ratio']:.2f}"
        counts = {f"count {n}": f"{n:,}" for row in record["confusion"] for n in row if n}
        ids = (self.season.mine, *self.season.entries.values())
        totals = [self.season.at.score_row(one).record["total"].values() for one in ids]
        shown = {f"{100 * ratio:.2f}" for of_entry in totals for ratio in of_entry if ratio}
        kept = {what: digits for what, digits in (ends | parts).items() if digits not in shown}
        return exact | kept | counts


@pytest.fixture
def hidden(reading: Reading, board: Season) -> Hidden:
    board.at.hide()
    return Hidden(reading, board)


def told(secrets: dict[str, str], html: str) -> set[str]:
    """Which of the secrets stand in the page, as whole numbers or the beginnings of longer ones."""
    judged = INSTANT.sub("", html)
    return {what for what, digits in secrets.items() if re.search(rf"(?<![0-9]){re.escape(digits)}", judged)}


@pytest.mark.whole
def test_neither_a_visitor_nor_the_team_reads_a_figure_that_is_hidden_and_an_administrator_does(
    hidden: Hidden, platform: Platform
) -> None:
    for who in (None, hidden.season.member):
        html = hidden.pages(who)
        assert "GroundNet++" in html
        assert told(hidden.secrets(), html) == set()
        for words in ('class="span"', "By sequence", "By environment", 'class="matrix"', "these sequences</li>"):
            assert words not in html
    miou = hidden.season.at.score_row(hidden.season.mine).record["total"]["miou"]
    assert f"{100 * round(miou, 4):.2f}" in hidden.reading.html(hidden.season.path)
    seen = told(hidden.secrets(), hidden.pages(person(platform, "administrator")))
    assert {what for what in hidden.secrets() if not what.startswith("exact")} <= seen


def test_when_the_phase_has_ended_everybody_reads_it(hidden: Hidden) -> None:
    hidden.season.at.end()
    html = hidden.pages()
    seen = told(hidden.secrets(), html)
    assert {what for what in hidden.secrets() if not what.startswith("exact")} <= seen
    assert "By environment" in html


def test_until_names_are_told_pages_hold_no_team_and_no_description(hidden: Hidden) -> None:
    hidden.season.at.hide(named_from_ns=2**62)
    html = hidden.pages()
    assert "Terrain Gang" not in html
    assert "Sparse convolutions" not in html
    assert "Terrain Gang" in hidden.pages(hidden.season.member)


def test_a_benchmark_that_is_not_public_shows_a_visitor_nothing(hidden: Hidden) -> None:
    world, reading = hidden.season, hidden.reading
    with world.at.platform.database.transaction() as session:
        session.query(Benchmark).filter_by(name=world.benchmark).one().is_public = False
    for path in (world.path, f"/benchmarks/{world.benchmark}", f"/entries/{world.mine}", f"{world.path}/compare"):
        answer = reading.answer(path)
        assert answer.status_code == 401, path
        assert "GroundNet++" not in answer.text
        assert reading.status(path, world.member) == 200
    assert world.benchmark not in reading.html("/benchmarks")
