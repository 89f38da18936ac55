"""The project as a wheel is the whole project: installed where there is no checkout, it serves its pages."""

import json
import os
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

from services.runtime.code_version import FIXED, RELEASE, code_version, digests_from, version_of
from services.runtime.source_digests import installed_places, source_digests
from tests.deploy.wheels import built_wheel
from web.assets import LIBRARIES

ROOT = Path(__file__).resolve().parents[3]
WHEEL = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["hatch"]["build"]["targets"]["wheel"]
PACKAGES: list[str] = WHEEL["packages"]
ASKED = """
import json, re, sys
from pathlib import Path
from fastapi.testclient import TestClient
import stone_client.main, stone_files
import web
from services.runtime.database.migrate import upgrade
from services.runtime.platform import open_platform
from services.runtime.settings import Settings
from web.main import make_site

settings = Settings()
upgrade(settings)
client = TestClient(make_site(open_platform(settings)))
page = client.get("/", headers={"Accept": "text/html"})
assets = re.findall(r'(?:src|href)="(/assets/[^"]+)"', page.text)
print(json.dumps({
    "web": web.__file__,
    "stone_files": stone_files.__file__,
    "status": page.status_code,
    "is_page": "</html>" in page.text,
    "assets": [client.get(path).status_code for path in assets],
}))
"""


@pytest.fixture(scope="module")
def sources() -> set[str]:
    """Every module of the project, as it was before the wheel was made."""
    found = [path for folder in (*PACKAGES, "stone_client") for path in (ROOT / folder).rglob("*.py")]
    return {path.relative_to(ROOT).as_posix() for path in found if "node_modules" not in path.parts}


@pytest.fixture(scope="module")
def wheel(sources: set[str], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built of all `sources` but the client's, as the images build it."""
    return built_wheel(ROOT, tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def client(sources: set[str], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel that the platform's stands on."""
    return built_wheel(ROOT / "deploy" / "client", tmp_path_factory.mktemp("client"))


@pytest.mark.whole
def test_the_wheel_serves_the_first_page_where_there_is_no_checkout(wheel: Path, client: Path, tmp_path: Path) -> None:
    """Catches alone a file that the pages need and the wheel leaves out."""
    site = tmp_path / "site"
    for one in (wheel, client):
        zipfile.ZipFile(one).extractall(site)  # which is all that installing it would do
    environment = {**os.environ, "PYTHONPATH": str(site), "STONE_DATA_FOLDER": str(tmp_path / "data")}
    outcome = subprocess.run(
        [sys.executable, "-P", "-c", ASKED], check=False, capture_output=True, text=True, env=environment, cwd=tmp_path
    )
    assert outcome.returncode == 0, outcome.stderr
    told = json.loads(outcome.stdout.splitlines()[-1])
    assert told["web"].startswith(str(site)), "the wheel's own, not the checkout's"
    assert Path(told["stone_files"]).parent == site / "stone_files", "one copy of it: not that in the client's wheel"
    assert (told["status"], told["is_page"]) == (200, True)
    assert len(told["assets"]) > 3
    assert set(told["assets"]) == {200}


@pytest.mark.whole
def test_the_wheels_hold_what_runs_once_and_not_what_it_is_made_of(
    wheel: Path, client: Path, sources: set[str]
) -> None:
    """Catches alone a source, or a module, that the wheel holds too much or too little of."""
    names = set(zipfile.ZipFile(wheel).namelist())
    assert {f"web/node_modules/{place}" for place in LIBRARIES.values()} == {
        name for name in names if name.startswith("web/node_modules/")
    }
    of_client = set(zipfile.ZipFile(client).namelist())
    assert sources <= names | of_client, "every module, every migration"
    assert not names & of_client
    assert {name.partition("/")[0] for name in names} == {*PACKAGES, f"stone_platform-{RELEASE}.dist-info"}
    assert not [name for name in names if name.endswith((".ts", ".pyc")) or "tests/" in name]
    assert any(name.startswith("web/templates/") for name in names)
    assert any(name.startswith("web/styles/") for name in names)


@pytest.mark.whole
def test_the_wheel_fixes_the_code_versions_that_it_was_built_with(wheel: Path) -> None:
    """Catches alone a wheel whose results would have the versions of other code, or of other libraries."""
    fixed = digests_from(json.loads(zipfile.ZipFile(wheel).read("services/runtime/source_digests.json")))
    here = source_digests(installed_places())
    assert {kind: one.sha256 for kind, one in fixed.items()} == {kind: one.sha256 for kind, one in here.items()}
    assert {kind: version_of(one) for kind, one in fixed.items()} == {kind: code_version(kind) for kind in here}
    assert not FIXED.exists(), "a build leaves nothing in the checkout"
