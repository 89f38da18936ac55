"""The steps that the submission form shows, run as they stand there, in an empty folder: by terminal and by browser.

Catches alone a step that names a file which no step before it wrote.
"""

import html
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from sqlalchemy import select

from services.runtime.access.passwords import hash_password
from services.runtime.orm import SubmissionRow, User
from services.runtime.platform import Platform
from testing.api.serving import person
from testing.web.browsing import Site
from testing.worlds.benchmark_world import World, run_eval
from testing.worlds.sending import standing_world
from tests.api.inputs_made import made_input
from tests.e2e.pasting import PASSWORD, shell_in
from tests.stone_client.participating import scoring

pytestmark = pytest.mark.whole
COPIED = re.compile(r'data-copies="([^"]+)"')


@pytest.fixture
def world(tmp_path: Path, _sqlite_template: Path) -> Iterator[World]:
    with standing_world(tmp_path / "platform", _sqlite_template, frames=1) as made:
        for name in made.grids["val"]:
            made_input(made.platform, made.val, name, {"v1.0-trainval/scene.json": b"[]"})
        yield made


@pytest.fixture
def platform(world: World) -> Platform:
    return world.platform


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "empty").mkdir()
    return tmp_path / "empty"


def methods(platform: Platform) -> list[tuple[str, str]]:
    with platform.database.reading() as session:
        rows = session.scalars(select(SubmissionRow).order_by(SubmissionRow.id))
        return [(row.method, row.state) for row in rows]


def test_the_lines_of_the_terminal_end_in_a_score(
    site: Site, world: World, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The client's installation is tested in tests/deploy/client."""
    newcomer = person(world.platform, "participant")
    with world.platform.database.transaction() as session:
        session.get_one(User, newcomer.user_id).password_hash = hash_password(PASSWORD)
    with site.visit(newcomer) as page:
        page.goto(f"/benchmarks/{world.benchmark}/val/submit")
        lines = [html.unescape(line) for line in COPIED.findall(page.locator(".first-steps .steps").inner_html())]
    lines = [line for line in lines if "pip install" not in line]
    said = {world.platform.settings.api.url.rstrip("/"): site.url}
    with shell_in(folder, said, monkeypatch) as shell, scoring(world.platform):
        shell.answers = f"{newcomer.name}\n{PASSWORD}\n"
        for line in ("unset -f curl", *lines):
            shell.type(line)
    assert methods(world.platform) == [("My method", "scored")]


def test_the_steps_of_the_browser_end_in_a_score(site: Site, world: World, folder: Path) -> None:
    with site.visit(world.captains[0]) as page:
        form = f"/benchmarks/{world.benchmark}/val/submit"
        page.goto(form)
        (line,) = page.locator(".first-steps .notes code").filter(has_text="python").all_inner_texts()
        page.goto(f"/benchmarks/{world.benchmark}/val/data")
        for link in ("Manifest", "predict.py"):
            with page.expect_download() as download:
                page.get_by_role("link", name=link, exact=True).click()
            download.value.save_as(folder / download.value.suggested_filename)
        words = line.split()
        subprocess.run([sys.executable, *words[1:]], cwd=folder, check=True, timeout=120)
        page.goto(form)
        page.locator("#file").set_input_files(folder / words[-1])
        page.get_by_label("Method name").fill("Flat")
        page.get_by_label("LiDAR").check()
        page.get_by_role("button", name="Submit for scoring").click()
        page.wait_for_url("**/submissions/*")
    run_eval(world.platform)
    assert methods(world.platform) == [("Flat", "scored")]
