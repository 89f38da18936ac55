"""What only a bucket can do to us: be away, refuse our keys, break off in the middle, keep halves of uploads."""

import random
import socket
import socketserver
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import pytest
from botocore.config import Config
from pydantic import SecretStr

from services.runtime.settings import StoreSettings
from services.runtime.store import s3
from services.runtime.store.keys import StoreAwayError
from services.runtime.store.s3 import S3Store
from testing.servers.fixtures import make_settings
from testing.servers.process import free_port

MIB = 2**20


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """One try, one second."""
    once = Config(connect_timeout=1, read_timeout=2, retries={"total_max_attempts": 1})
    monkeypatch.setattr(s3, "CLIENT", s3.CLIENT.merge(once))


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize("fault", ["nobody listens", "wrong secret", "unknown key", "no bucket"])
def test_a_bucket_that_cannot_be_reached_is_said_to_be_away(
    s3_settings: StoreSettings, tmp_path: Path, fault: str
) -> None:
    settings = {
        "nobody listens": replace(s3_settings, s3_endpoint=f"http://127.0.0.1:{free_port()}"),
        "wrong secret": replace(s3_settings, s3_secret=SecretStr("wrong")),
        "unknown key": replace(s3_settings, s3_key_id="nobody"),
        "no bucket": replace(s3_settings, s3_bucket="none"),
    }[fault]
    store = S3Store(make_settings(tmp_path, store=settings))
    source = tmp_path / "source"
    source.write_bytes(b"content")
    with pytest.raises(StoreAwayError, match=f"the store at {settings.s3_endpoint}/{settings.s3_bucket} failed"):
        store.write("blobs/a", source)
    with pytest.raises(StoreAwayError):
        list(store.listed("blobs/"))
    assert settings.s3_secret.get_secret_value() not in str(store.__dict__)


def test_a_read_that_breaks_off_is_resumed_where_it_stopped(s3_settings: StoreSettings, tmp_path: Path) -> None:
    content = random.Random(1).randbytes(8 * MIB)
    source = tmp_path / "source"
    source.write_bytes(content)
    S3Store(make_settings(tmp_path, store=s3_settings)).write("blobs/a", source)
    with unreliable(s3_settings, answer_bytes=3 * MIB) as (settings, broken):
        store = S3Store(make_settings(tmp_path / "other", store=settings))
        assert b"".join(store.read("blobs/a", 5)) == content[5:]
        assert store.local("blobs/a").read_bytes() == content
        store._client.close()
    assert len(broken) >= 4


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize("answer_bytes", [40, 400, 900])
def test_a_read_that_never_gets_further_ends(
    s3_settings: StoreSettings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, answer_bytes: int
) -> None:
    monkeypatch.setattr(s3, "RESUMES", 2)
    source = tmp_path / "source"
    source.write_bytes(b"x" * MIB)
    S3Store(make_settings(tmp_path, store=s3_settings)).write("blobs/a", source)
    with unreliable(s3_settings, answer_bytes=answer_bytes) as (settings, _):
        store = S3Store(make_settings(tmp_path / "other", store=settings))
        with pytest.raises(StoreAwayError, match="try again"):
            b"".join(store.read("blobs/a"))
        with pytest.raises(StoreAwayError, match="try again"):
            store.local("blobs/a")
        store._client.close()
    assert [path for path in (tmp_path / "other").rglob("blobs/a") if path.is_file()] == []


def test_an_upload_whose_writer_died_is_aborted_and_a_young_one_is_not(
    s3_settings: StoreSettings, tmp_path: Path
) -> None:
    store = S3Store(make_settings(tmp_path, store=s3_settings))
    client = store._client
    begun = client.create_multipart_upload(Bucket=store.bucket, Key="blobs/a")
    part, id = b"x" * 5 * MIB, begun["UploadId"]
    client.upload_part(Bucket=store.bucket, Key="blobs/a", UploadId=id, PartNumber=1, Body=part)
    assert store.tidy(3600.0) == 0
    assert len(client.list_parts(Bucket=store.bucket, Key="blobs/a", UploadId=id)["Parts"]) == 1
    assert store.tidy(-5.0) == 1
    with pytest.raises(client.exceptions.NoSuchUpload):
        client.list_parts(Bucket=store.bucket, Key="blobs/a", UploadId=id)
    assert store.tidy(-5.0) == 0


@contextmanager
def unreliable(behind: StoreSettings, answer_bytes: int) -> Iterator[tuple[StoreSettings, list[int]]]:
    """The same bucket through a line that is cut after so many bytes of answer; how often it was."""
    broken: list[int] = []

    class Line(socketserver.BaseRequestHandler):
        def handle(self) -> None:
            with socket.create_connection(("127.0.0.1", int(behind.s3_endpoint.rpartition(":")[2]))) as server:
                asking = threading.Thread(target=_ask, args=(self.request, server))
                asking.start()
                left = answer_bytes
                with suppress(OSError):
                    while left and (answer := server.recv(min(left, MIB))):
                        self.request.sendall(answer)
                        left -= len(answer)
                broken.extend([1] * (not left))
                for side in (self.request, server):
                    with suppress(OSError):
                        side.shutdown(socket.SHUT_RDWR)
                asking.join()

    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), Line) as listener:
        listener.daemon_threads = True
        thread = threading.Thread(target=listener.serve_forever, args=(0.05,))
        thread.start()
        try:
            yield replace(behind, s3_endpoint=f"http://127.0.0.1:{listener.server_address[1]}"), broken
        finally:
            listener.shutdown()
            thread.join()


def _ask(client: socket.socket, server: socket.socket) -> None:
    """Pass on what is asked until either side is gone."""
    with suppress(OSError):
        while asked := client.recv(MIB):
            server.sendall(asked)
        server.shutdown(socket.SHUT_WR)
