"""An upload that is broken off in the middle goes on: the API killed, the page loaded again, the reader pausing it."""

import re
import socket
from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, Response, expect

from services.ingest.queue_handlers import handlers
from services.runtime.platform import Platform
from services.runtime.uploads import upload_file
from services.runtime.uploads.files import offset_of
from testing.api.process import ApiProcess
from testing.api.serving import Person
from testing.web.browsing import Site
from tests.web.bringing import BULKY, bag, choose, recordings, row_of, slow_down, uploads
from tests.web.looking import look
from tests.working import working

SLOW = 8e5
"""So slow that a loaded machine, looking late, still finds most of the file unsent."""
HELD = 2e4
"""So slow that a file does not end while a loaded machine takes its pictures."""
ENOUGH = 3 << 20


class Machine(ApiProcess):
    """What `go_down` kills leaves nobody listening on its port, unlike `kill`, behind a supervisor's socket."""

    def start(self) -> None:
        if self._listening.fileno() < 0:
            self._listening = socket.create_server(("127.0.0.1", self.port))
        super().start()

    def go_down(self) -> None:
        self.kill()
        self._listening.close()


@pytest.fixture
def process(platform: Platform, tmp_path: Path) -> Iterator[Machine]:
    running = Machine(platform.settings, tmp_path / "api.log")
    try:
        running.start()
        yield running
    finally:
        running.close()


def pieces_taken(page: Page) -> list[int]:
    """Where the pieces begin that are sent from now on and taken."""
    seen: list[int] = []

    def note(answer: Response) -> None:
        if answer.request.method == "PATCH" and answer.status == 204:
            seen.append(int(answer.request.headers["upload-offset"]))

    page.on("response", note)
    return seen


def bytes_here(platform: Platform) -> int:
    """How much of the newest upload is on disk and counts."""
    rows = [row for row in uploads(platform) if row.state != "terminated"]
    return offset_of(upload_file(platform.settings, rows[-1].id)) if rows else 0


def hold_at(page: Page, platform: Platform, at_least: int) -> None:
    """Until so much is on disk; from there the page goes on at a trickle."""
    for _ in range(4000):
        if bytes_here(platform) >= at_least:
            return slow_down(page, HELD)
        page.wait_for_timeout(25)
    raise AssertionError(f"{bytes_here(platform)} bytes are here, and no more come")


def check_kept_once(platform: Platform, path: Path) -> None:
    *given_up, upload = uploads(platform)
    (recording,) = recordings(platform)
    assert {row.state for row in given_up} <= {"terminated"}
    assert upload.state == "consumed"
    assert (recording.state, recording.sha256) == ("registered", sha256(path.read_bytes()).hexdigest())


def test_the_api_is_killed_in_the_middle_twice_and_the_page_goes_on(
    process: Machine, platform: Platform, browser: Browser, curator: Person
) -> None:
    """First behind its supervisor's socket, where the page waits for an answer; then with its machine."""
    site, path = Site(process.url, platform, browser), bag(BULKY, "long-run")
    on_disk, taken = [], []
    expected = ["ERR_", "Failed to load resource"]
    with site.visit(curator, expected=expected) as page, working(platform, "ingest", handlers):
        page.goto("/sequences/new")
        choose(page, path)
        slow_down(page, SLOW)
        page.get_by_role("button", name="Upload").click()
        row = row_of(page, "long-run.mcap")
        for kill, at_least in ((process.kill, ENOUGH), (process.go_down, 2 * ENOUGH)):
            hold_at(page, platform, at_least)
            expect(row.locator("[data-phase]")).to_have_text("uploading")
            kill()
            on_disk.append(bytes_here(platform))
            taken.append(pieces_taken(page))
            if kill == process.go_down:
                expect(row.locator("[data-phase]")).to_have_text("waiting for the platform", timeout=300_000)
            slow_down(page, SLOW if kill == process.kill else -1)
            process.start()
        expect(row.locator("[data-phase]")).to_have_text("registered", timeout=300_000)
    assert ENOUGH <= on_disk[0] < 2 * ENOUGH <= on_disk[1] < path.stat().st_size
    assert [pieces[0] for pieces in taken] == on_disk
    check_kept_once(platform, path)


def test_an_upload_is_paused_and_given_up_and_goes_on_where_the_page_is_loaded_again(
    site: Site, curator: Person
) -> None:
    path = bag(BULKY, "long-run")
    with site.visit(curator) as page, working(site.platform, "ingest", handlers):
        page.goto("/sequences/new")
        row, unfinished = row_of(page, "long-run.mcap"), page.get_by_role("region", name="Unfinished uploads")
        _sent_in_part(page, site.platform, path, "forest")
        row.get_by_role("button", name="Pause").click()
        expect(row.locator("[data-phase]")).to_have_text("paused")
        row.get_by_role("button", name="Remove").click()
        page.reload()
        page.get_by_role("button", name="Discard long-run.mcap").click()
        expect(unfinished).to_be_hidden()
        (given_up,) = uploads(site.platform)
        assert given_up.state == "terminated"
        _sent_in_part(page, site.platform, path, "meadow")
        page.goto("/sequences")
        card = page.get_by_role("listitem").filter(has=page.get_by_role("link", name="meadow", exact=True))
        expect(card).to_contain_text("upload unfinished")
        expect(card).to_contain_text(re.compile(r"\d+ % of [\d.]+ MB uploaded"))
        look(page, "sequences-half-uploaded")
        card.get_by_role("link", name="Resume").click()
        expect(page.get_by_role("region", name="Unfinished uploads")).to_contain_text("long-run.mcap for meadow")
        page.go_back()
        page.go_back()
        expect(unfinished).to_contain_text("long-run.mcap for meadow")
        slow_down(page, -1)
        taken = pieces_taken(page)
        choose(page, path)
        expect(row.locator("[data-phase]")).to_have_text("registered", timeout=300_000)
        expect(unfinished).to_be_hidden()
    assert taken[0] >= ENOUGH
    check_kept_once(site.platform, path)


def _sent_in_part(page: Page, platform: Platform, path: Path, sequence: str) -> None:
    choose(page, path)
    row_of(page, path.name).get_by_label("Sequence").fill(sequence)
    slow_down(page, SLOW)
    page.get_by_role("button", name="Upload").click()
    hold_at(page, platform, ENOUGH)
