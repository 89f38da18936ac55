"""A file arrives whole whatever ends in between: the client, the server, the file itself.

Catches alone a client that loses or repeats bytes when something ends in between.
"""

import os
import subprocess
import sys
from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path

import pytest

from services.runtime.platform import Platform
from services.runtime.uploads import upload_file as stored_file
from stone_client.api import Api
from stone_client.credentials import Server
from stone_client.errors import FileChangedError
from stone_client.files.tus import LocalFile, Purpose, hashed, upload_file
from testing.api.process import ApiProcess, running_api
from testing.api.serving import Person, person
from testing.stone_serve import until

pytestmark = pytest.mark.whole

SIZE_BYTES = 24 * 2**20
RECORDING = Purpose("recording")
CLIENT = """
import sys
from pathlib import Path
import stone_client.files.tus
from stone_client.api import Api
from stone_client.credentials import Server
stone_client.files.tus.PIECE_BYTES = 2**16
path = Path(sys.argv[3])
with Api(Server(sys.argv[1], sys.argv[2])) as api:
    local = stone_client.files.tus.hashed(path, lambda *_: None)
    print(stone_client.files.tus.upload_file(api, local, stone_client.files.tus.Purpose("recording"), lambda *_: None))
"""


def quiet(stage: str, done: int, total: int) -> None:
    """Tests watch nothing."""


@pytest.fixture
def owner(platform: Platform) -> Person:
    return person(platform, "curator")


@pytest.fixture
def server(platform: Platform, tmp_path: Path) -> Iterator[ApiProcess]:
    with running_api(platform.settings, tmp_path / "api.log") as process:
        yield process


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "run é.mcap"
    path.write_bytes(os.urandom(SIZE_BYTES))
    return path


def sending(server: ApiProcess, owner: Person, file: Path) -> subprocess.Popen[str]:
    """A client that sends the file in many small pieces."""
    command = [sys.executable, "-c", CLIENT, server.url, owner.secret, str(file)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def offset_of(api: Api) -> int:
    return sum(int(item["offset_bytes"]) for item in api.pages("/uploads"))


def test_a_client_that_is_killed_goes_on_where_it_was(
    platform: Platform, server: ApiProcess, owner: Person, file: Path
) -> None:
    with Api(Server(server.url, owner.secret)) as api:
        client = sending(server, owner, file)
        until(lambda: offset_of(api) > 2**20)
        client.kill()
        client.communicate()
        begun = offset_of(api)
        assert 2**20 < begun < SIZE_BYTES, "killed on its way"
        told: list[tuple[str, int, int]] = []
        upload_id = upload_file(api, hashed(file, quiet), RECORDING, lambda *said: told.append(said))
        assert begun <= told[0][1] < SIZE_BYTES, "it began where the killed one ended"
        assert told[-1] == ("upload", SIZE_BYTES, SIZE_BYTES)
        (only,) = api.pages("/uploads")
    assert (only["id"], only["state"], only["filename"]) == (upload_id, "complete", "run é.mcap")
    assert stored_file(platform.settings, upload_id).read_bytes() == file.read_bytes()
    assert only["sha256"] == sha256(file.read_bytes()).hexdigest()


def test_a_server_that_is_killed_and_comes_back_is_waited_for(
    platform: Platform, server: ApiProcess, owner: Person, file: Path
) -> None:
    """Catches alone a client that gives up, or sends twice, when the server is killed on its way."""
    with Api(Server(server.url, owner.secret)) as api:
        client = sending(server, owner, file)
        until(lambda: offset_of(api) > 2**20)
        server.kill()
        server.start()
        said, complaint = client.communicate(timeout=300)
        assert client.returncode == 0, complaint
    assert stored_file(platform.settings, said.strip()).read_bytes() == file.read_bytes()


def test_the_same_file_again_is_not_sent_again(server: ApiProcess, owner: Person, file: Path) -> None:
    with Api(Server(server.url, owner.secret)) as api:
        local = hashed(file, quiet)
        first = upload_file(api, local, RECORDING, quiet)
        told: list[tuple[str, int, int]] = []
        assert upload_file(api, local, RECORDING, lambda *said: told.append(said)) == first
    assert told == [("upload", SIZE_BYTES, SIZE_BYTES)]


def test_an_empty_file_arrives_too(server: ApiProcess, owner: Person, tmp_path: Path) -> None:
    (tmp_path / "empty.mcap").write_bytes(b"")
    with Api(Server(server.url, owner.secret)) as api:
        upload_id = upload_file(api, hashed(tmp_path / "empty.mcap", quiet), RECORDING, quiet)
        assert api.read(f"/uploads/{upload_id}")["state"] == "complete"


def test_a_file_that_is_still_being_written_is_refused(server: ApiProcess, owner: Person, file: Path) -> None:
    local = hashed(file, quiet)
    with file.open("ab") as recorder:
        recorder.write(b"more")
    with Api(Server(server.url, owner.secret)) as api, pytest.raises(FileChangedError, match="still being written"):
        upload_file(api, local, RECORDING, quiet)


def test_two_files_of_one_name_are_two_uploads(server: ApiProcess, owner: Person, tmp_path: Path) -> None:
    def written(folder: str, content: bytes) -> LocalFile:
        path = tmp_path / folder / "run.mcap"
        path.parent.mkdir()
        path.write_bytes(content)
        return hashed(path, quiet)

    with Api(Server(server.url, owner.secret)) as api:
        first = upload_file(api, written("a", b"one"), RECORDING, quiet)
        assert upload_file(api, written("b", b"two"), RECORDING, quiet) != first
