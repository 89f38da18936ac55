"""The clients that people have: tuspy, tus-js-client and curl, against the API in a process of its own.

Catches alone what clients of others find of our protocol that our own client does not.
"""

import io
import json
import os
import random
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import pytest
from tusclient.client import TusClient

from services.runtime.platform import Platform
from services.runtime.uploads import upload_file
from testing.api.process import running_api
from testing.api.serving import Person, person
from testing.api.tus import UPLOADS, sha256_of, shown
from testing.servers.fixtures import make_settings, opened

CLIENTS = Path(__file__).resolve().parents[1] / "clients"
INSTALL = "deploy/install-test-clients.sh"

pytestmark = pytest.mark.whole


@dataclass(frozen=True)
class Served:
    """A running API, its platform from the inside, an owner, and a file to send."""

    platform: Platform
    url: str
    owner: Person
    file: Path

    @property
    def endpoint(self) -> str:
        return f"{self.url}{UPLOADS}"

    @property
    def content(self) -> bytes:
        return self.file.read_bytes()

    @property
    def said(self) -> dict[str, str]:
        return {"filename": self.file.name, "purpose": "recording", "sha256": sha256_of(self.content)}

    def check(self, url: str) -> None:
        """What the client calls `url` is complete here, byte for byte."""
        with httpx.Client(base_url=self.url) as api:
            state = shown(api, self.owner, UPLOADS + "/" + url.rpartition("/")[2])
        assert (state["state"], state["sha256"]) == ("complete", sha256_of(self.content))
        assert upload_file(self.platform.settings, state["id"]).read_bytes() == self.content


@contextmanager
def served_platform(folder: Path, template: Path) -> Iterator[Platform]:
    settings = make_settings(folder)
    settings.root.mkdir(parents=True)
    shutil.copyfile(template, settings.root / "stone.sqlite3")
    platform = opened(settings, [])
    yield platform
    platform.database.close()


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory, _sqlite_template: Path) -> Iterator[Served]:
    folder = tmp_path_factory.mktemp("clients")
    with served_platform(folder, _sqlite_template) as platform:
        file = folder / "Süd run.mcap"
        file.write_bytes(random.Random(1).randbytes((5 << 20) + 17))
        with running_api(platform.settings, folder / "api.log") as process:
            yield Served(platform, process.url, person(platform, "curator"), file)


@pytest.fixture
def another(served: Served, tmp_path: Path) -> Served:
    """The same API with a file that it has not seen."""
    file = tmp_path / "run.mcap"
    file.write_bytes(os.urandom((3 << 20) + 5))
    return Served(served.platform, served.url, served.owner, file)


def tuspy(served: Served, **options: Any) -> Any:
    """tuspy leaves files it opened itself open, so it is given a stream."""
    client = TusClient(served.endpoint, headers=dict(served.owner.headers))
    return client.uploader(file_stream=io.BytesIO(served.content), metadata=served.said, **options)


@pytest.mark.parametrize(("chunk_bytes", "with_checksum"), [(None, True), (1 << 20, False), (1 << 20, True)])
def test_tuspy_sends_a_file(another: Served, chunk_bytes: int | None, with_checksum: bool) -> None:
    sized = {} if chunk_bytes is None else {"chunk_size": chunk_bytes}
    uploader = tuspy(another, upload_checksum=with_checksum, **sized)
    uploader.upload()
    another.check(uploader.url)


def test_tuspy_goes_on_where_it_stopped(another: Served) -> None:
    begun = tuspy(another, chunk_size=1 << 20)
    begun.upload_chunk()
    resumed = tuspy(another, chunk_size=1 << 20, url=begun.url)
    assert resumed.offset == 1 << 20
    resumed.upload()
    another.check(begun.url)


def test_tuspy_has_nothing_to_send_when_the_file_is_here(another: Served) -> None:
    first = tuspy(another)
    first.upload()
    created = httpx.post(another.endpoint, headers={**another.owner.headers, **dict(first.get_url_creation_headers())})
    again = tuspy(another, url=f"{another.url}{created.headers['Location']}")
    assert again.offset == len(another.content)
    another.check(again.url)


@pytest.fixture(scope="module")
def node() -> str:
    found = shutil.which("node")
    if found is None:
        pytest.skip("node is not on PATH")
    if not (CLIENTS / "node_modules" / "tus-js-client").is_dir():
        pytest.skip(f"tus-js-client is not installed: run {INSTALL}")
    return found


def tus_js(node: str, served: Served, **asked: Any) -> dict[str, Any]:
    said = {"endpoint": served.endpoint, "token": served.owner.secret, "path": str(served.file)}
    order = json.dumps({"metadata": served.said, **said, **asked})
    done = subprocess.run([node, "upload.mjs", order], cwd=CLIENTS, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    outcome: dict[str, Any] = json.loads(done.stdout)
    return outcome


def test_tus_js_client_is_told_why_it_is_refused(node: str, another: Served) -> None:
    outcome = tus_js(node, another, metadata={**another.said, "purpose": "avatar"})
    assert (outcome["outcome"], outcome["status"]) == ("refused", 422)
    assert json.loads(outcome["body"])["code"] == "bad_upload_metadata"
    outcome = tus_js(node, another, metadata={**another.said, "sha256": "0" * 64})
    assert (outcome["outcome"], outcome["status"]) == ("refused", 460)


@pytest.mark.parametrize(
    "options", [{}, {"chunkSize": 1 << 20}, {"duringCreation": True, "chunkSize": 1 << 20}, {"overridePatch": True}]
)
def test_tus_js_client_sends_a_file(node: str, another: Served, options: dict[str, Any]) -> None:
    outcome = tus_js(node, another, **options)
    assert outcome["outcome"] == "complete", outcome
    another.check(outcome["url"])


def test_tus_js_client_goes_on_where_it_gave_up(node: str, another: Served) -> None:
    outcome = tus_js(node, another, chunkSize=1 << 20, abortAfter=1 << 20)
    assert outcome["outcome"] == "aborted", outcome
    resumed = tus_js(node, another, resume=outcome["url"], retryDelays=[100, 300, 1000])
    assert (resumed["outcome"], resumed["url"]) == ("complete", outcome["url"])
    another.check(outcome["url"])


def curl(served: Served, *arguments: str) -> tuple[int, dict[str, Any]]:
    found = shutil.which("curl")
    if found is None:
        pytest.skip("curl is not on PATH")
    command = [found, "--silent", "--show-error", "--header", f"Authorization: Bearer {served.owner.secret}"]
    done = subprocess.run(
        [*command, "--write-out", "\n%{http_code}", *arguments], capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    body, _, status = done.stdout.rpartition("\n")
    return int(status), json.loads(body)


@pytest.mark.parametrize("purpose_comes_first", [True, False])
def test_curl_sends_a_small_file(another: Served, purpose_comes_first: bool) -> None:
    fields = [f"file=@{another.file}", "purpose=recording"]
    first, second = reversed(fields) if purpose_comes_first else fields
    status, body = curl(another, "--form", first, "--form", second, f"{another.endpoint}/form")
    assert status == 201, body
    another.check(body["id"])
