"""An upload that is broken off in the middle goes on: the API killed, the page loaded again, the reader pausing it."""

import socket
from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import Browser, Page, Response, expect

from services.ingest.queue_handlers import handlers
from services.runtime.platform import Platform
from services.runtime.uploads import upload_file
from services.runtime.uploads.files import offset_of
from testing.api.process import ApiProcess
from testing.api.serving import Person
from testing.web.browsing import Site
from testing.worlds.made import sequence
from tests.web.bringing import BULKY, bag, choose, recordings, row_of, slow_down, uploads
from tests.working import working

SLOW = 8e5
"""So slow that a loaded machine, looking late, still finds most of the file unsent."""
HELD = 2e4
"""So slow that a file does not end while a loaded machine takes its pictures."""
ENOUGH = 3 << 20


class Machine(ApiProcess):
    """Alone on its port: while it is down, nobody listens there."""

    def start(self) -> None:
        if self._listening.fileno() < 0:
            self._listening = socket.create_server(("127.0.0.1", self.port))
        super().start()

    def kill(self) -> None:
        super().kill()
        self._listening.close()


@pytest.fixture(params=[ApiProcess, Machine], ids=["behind its supervisor's socket", "with its machine"])
def process(request: pytest.FixtureRequest, platform: Platform, tmp_path: Path) -> Iterator[ApiProcess]:
    running: ApiProcess = request.param(platform.settings, tmp_path / "api.log")
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
    """How much of the one upload is on disk and counts."""
    rows = uploads(platform)
    return offset_of(upload_file(platform.settings, rows[0].id)) if rows else 0


def hold_at(page: Page, platform: Platform, at_least: int) -> None:
    """Until so much is on disk; from there the page goes on at a trickle."""
    for _ in range(400):
        if bytes_here(platform) >= at_least:
            return slow_down(page, HELD)
        page.wait_for_timeout(25)
    raise AssertionError(f"{bytes_here(platform)} bytes are here, and no more come")


def check_kept_once(platform: Platform, path: Path) -> None:
    (upload,), (recording,) = uploads(platform), recordings(platform)
    assert upload.state == "consumed"
    assert (recording.state, recording.sha256) == ("registered", sha256(path.read_bytes()).hexdigest())


def test_the_api_is_killed_in_the_middle_and_the_page_goes_on(
    process: ApiProcess, platform: Platform, browser: Browser, curator: Person
) -> None:
    site, path = Site(process.url, platform, browser), bag(BULKY, "long-run")
    expected = ["ERR_", "Failed to load resource"]
    with site.visit(curator, expected=expected) as page, working(platform, "ingest", handlers):
        page.goto("/sequences/new")
        choose(page, path)
        slow_down(page, SLOW)
        page.get_by_role("button", name="Upload").click()
        row = row_of(page, "long-run.mcap")
        hold_at(page, platform, ENOUGH)
        expect(row.locator("[data-phase]")).to_have_text("uploading")
        expect(row.locator(".transfer-line")).to_contain_text("left")
        process.kill()
        on_disk, taken = bytes_here(platform), pieces_taken(page)
        if isinstance(process, Machine):
            expect(row.locator("[data-phase]")).to_have_text("waiting for the platform", timeout=300_000)
        slow_down(page, -1)
        process.start()
        expect(row.locator("[data-phase]")).to_have_text("registered", timeout=300_000)
    assert ENOUGH <= on_disk < path.stat().st_size
    assert taken[0] == on_disk
    check_kept_once(platform, path)


def test_the_page_is_loaded_again_and_the_same_file_goes_on(site: Site, curator: Person) -> None:
    path = bag(BULKY, "long-run")
    with site.visit(curator) as page, working(site.platform, "ingest", handlers):
        page.goto("/sequences/new")
        choose(page, path)
        slow_down(page, SLOW)
        page.get_by_role("button", name="Upload").click()
        hold_at(page, site.platform, ENOUGH)
        page.reload()
        unfinished = page.get_by_role("region", name="Unfinished uploads")
        expect(unfinished).to_contain_text("long-run.mcap for long-run")
        slow_down(page, -1)
        taken = pieces_taken(page)
        choose(page, path)
        expect(row_of(page, "long-run.mcap").locator("[data-phase]")).to_have_text("registered", timeout=300_000)
        expect(unfinished).to_be_hidden()
    assert taken[0] >= ENOUGH
    check_kept_once(site.platform, path)


def test_a_pause_holds_still_and_what_is_there_can_be_given_up(site: Site, curator: Person) -> None:
    with httpx.Client(base_url=site.url) as api:
        made = sequence(api, curator, "forest")
    with site.visit(curator) as page:
        page.goto(f"/sequences/{made['id']}")
        slow_down(page, SLOW)
        choose(page, bag(BULKY, "long-run"))
        row = row_of(page, "long-run.mcap")
        hold_at(page, site.platform, ENOUGH)
        row.get_by_role("button", name="Pause").click()
        expect(row.locator("[data-phase]")).to_have_text("paused")
        row.get_by_role("button", name="Remove").click()
        page.reload()
        page.get_by_role("button", name="Discard long-run.mcap").click()
        expect(page.get_by_role("region", name="Unfinished uploads")).to_be_hidden()
    assert [row.state for row in uploads(site.platform)] == ["terminated"]
