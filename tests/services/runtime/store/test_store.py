"""What both stores promise, on a local folder and a real S3 server; what only a bucket or a full disk can do."""

import hashlib
import os
import random
import signal
import socket
import socketserver
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import pytest
from botocore.config import Config
from pydantic import SecretStr
from sqlalchemy import func, select

from services.runtime.orm import LooseObject
from services.runtime.platform import Platform
from services.runtime.settings import Settings, StoreSettings
from services.runtime.store import s3
from services.runtime.store.blobs import collect_garbage, link, prepare
from services.runtime.store.factory import open_store
from services.runtime.store.folder import FolderStore
from services.runtime.store.keys import ObjectMissingError, StoreFullError
from services.runtime.store.protocol import Store
from services.runtime.store.s3 import S3Store
from services.runtime.store.workspace import Workspace
from testing.refusals import refused_as
from testing.servers.fixtures import make_settings
from testing.servers.process import free_port
from testing.servers.s3 import S3Server

MIB = 2**20
LARGE_BYTES = 40 * MIB + 12_345  # three parts on S3

WRITE_FOR_EVER = """
import sys
from itertools import count
from pathlib import Path
from services.runtime.settings import Settings
from services.runtime.store.factory import open_store
store = open_store(Settings())
for number in count():
    store.write(f"blobs/{number}", Path(sys.argv[1]))
    sys.stdout.write(f"{number}\\n")
    sys.stdout.flush()
"""


@pytest.fixture(params=["folder", "s3"])
def stored(request: pytest.FixtureRequest, tmp_path: Path) -> Settings:
    """Settings of a store, empty."""
    if request.param == "folder":
        return make_settings(tmp_path)
    return make_settings(tmp_path, store=request.getfixturevalue("s3_settings"))


@pytest.fixture
def store(stored: Settings) -> Store:
    return open_store(stored)


@pytest.fixture
def behind(stored: Settings, request: pytest.FixtureRequest) -> Path:
    """Where the bytes really are: the store's folder, or the folder of the bucket in the S3 server."""
    if not stored.store.s3_bucket:
        return stored.root / "store"
    server: S3Server = request.getfixturevalue("s3_server")
    return server.buckets / stored.store.s3_bucket


def file_of(folder: Path, content: bytes, name: str = "source") -> Path:
    path = folder / name
    path.write_bytes(content)
    return path


@pytest.mark.parametrize(
    "key",
    [
        *("", "blobs/", "/blobs/a", "blobs//a", "blobs/../../a", "blobs/.hidden", "Blobs/a", "blobs/a b"),
        *("blobs/a\n", "blobs/a\0", "blobs/é", "blobs\\a/b", "a/" + "b" * 511, "~/a", "blobs/%2e%2e/a"),
    ],
)
def test_a_key_that_could_leave_the_store_is_refused(store: Store, tmp_path: Path, key: str) -> None:
    source = file_of(tmp_path, b"x")
    for act in (
        lambda: store.write(key, source),
        lambda: store.adopt(key, source),
        lambda: store.read(key),
        lambda: store.size_bytes(key),
        lambda: store.local(key),
        lambda: store.delete(key),
    ):
        with refused_as("bad_key"):
            act()


@pytest.mark.parametrize("prefix", ["../", "/", "blobs/..", ".staging", "blobs//", "B"])
def test_a_prefix_that_could_leave_the_store_is_refused(store: Store, prefix: str) -> None:
    with refused_as("bad_key"):
        list(store.listed(prefix))


def test_an_object_that_is_not_there_is_missing_whatever_is_asked(store: Store) -> None:
    for act in (
        lambda: store.read("blobs/none"),
        lambda: store.read("blobs/none", 3, 3),
        lambda: store.size_bytes("blobs/none"),
        lambda: store.local("blobs/none"),
    ):
        with pytest.raises(ObjectMissingError):
            act()
    store.delete("blobs/none")


@pytest.mark.parametrize(("start", "stop"), [(-1, None), (5, 4), (-3, -2)])
def test_a_range_that_is_none_is_refused(store: Store, tmp_path: Path, start: int, stop: int | None) -> None:
    store.write("blobs/a", file_of(tmp_path, b"0123456789"))
    with pytest.raises(ValueError, match="bad byte range"):
        store.read("blobs/a", start, stop)


@pytest.mark.parametrize("size_bytes", [0, 1, MIB])
def test_what_was_written_is_read_back(store: Store, tmp_path: Path, size_bytes: int) -> None:
    content = random.Random(size_bytes).randbytes(size_bytes)
    source = file_of(tmp_path, content)
    store.write("blobs/ab/object.1", source)
    assert b"".join(store.read("blobs/ab/object.1")) == content
    assert store.size_bytes("blobs/ab/object.1") == size_bytes
    assert store.local("blobs/ab/object.1").read_bytes() == content
    assert source.read_bytes() == content


@pytest.mark.parametrize(
    ("start", "stop"),
    [
        *((0, None), (0, 0), (7, 7), (1, 2), (MIB - 1, 2 * MIB + 1), (17 * MIB, 33 * MIB), (LARGE_BYTES - 1, None)),
        *((LARGE_BYTES, None), (LARGE_BYTES + 9, None), (LARGE_BYTES - 5, LARGE_BYTES + 5)),
    ],
)
def test_a_range_is_that_slice_of_the_bytes(large: tuple[Store, bytes], start: int, stop: int | None) -> None:
    store, content = large
    pieces = list(store.read("blobs/large", start, stop))
    assert b"".join(pieces) == content[start:stop]
    assert all(0 < len(piece) <= MIB for piece in pieces)


@pytest.fixture(scope="module", params=["folder", "s3"])
def large(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Store, bytes]:
    folder = tmp_path_factory.mktemp("large")
    groups = {}
    if request.param == "s3":
        server: S3Server = request.getfixturevalue("s3_server")
        groups = {"store": server.settings()}
    store = open_store(make_settings(folder, **groups))
    content = random.Random(1).randbytes(LARGE_BYTES)
    store.write("blobs/large", file_of(folder, content))
    return store, content


def test_an_adopted_file_is_stored_and_stays_until_its_owner_removes_it(store: Store, tmp_path: Path) -> None:
    source = file_of(tmp_path, b"content")
    os.utime(source, (1, 1))
    store.adopt("blobs/a", source)
    assert source.read_bytes() == b"content"
    source.unlink()
    assert b"".join(store.read("blobs/a")) == b"content"
    (listed,) = store.listed("blobs/")
    assert abs(listed.modified_ns - time.time_ns()) < 60e9, "an old file makes a new object"


def test_a_deleted_object_is_gone_and_its_neighbours_stay(store: Store, tmp_path: Path) -> None:
    for key in ("work/r/a/1", "work/r/a/2", "work/r/b"):
        store.write(key, file_of(tmp_path, b"x"))
    store.delete("work/r/a/1")
    store.delete("work/r/a/2")
    assert [found.key for found in store.listed("")] == ["work/r/b"]
    store.write("work/r/a/1", file_of(tmp_path, b"again"))
    assert b"".join(store.read("work/r/a/1")) == b"again"


def test_objects_are_listed_in_the_order_of_their_keys_with_size_and_age(store: Store, tmp_path: Path) -> None:
    keys = ["work/a-b/z", "work/a/x", "work/a/y/1", "work/a.b/z", "work/a0", "blobs/0", "work/a/y.1"]
    for size_bytes, key in enumerate(keys):
        store.write(key, file_of(tmp_path, b"x" * size_bytes))
    assert [found.key for found in store.listed("")] == sorted(keys)
    assert [found.key for found in store.listed("work/a/")] == ["work/a/x", "work/a/y.1", "work/a/y/1"]
    assert [found.key for found in store.listed("work/a/y")] == ["work/a/y.1", "work/a/y/1"]
    assert [found.key for found in store.listed("work/a/y/1")] == ["work/a/y/1"]
    assert list(store.listed("none/")) == []
    found = {entry.key: entry for entry in store.listed("")}
    assert [found[key].size_bytes for key in keys] == list(range(len(keys)))
    assert all(abs(entry.modified_ns - time.time_ns()) < 60e9 for entry in found.values())


def test_more_objects_than_a_page_holds_are_all_listed(
    store: Store, behind: Path, s3_server: S3Server, tmp_path: Path
) -> None:
    store.write("work/r/seed", file_of(tmp_path, b"x"))
    for number in range(1205):
        (behind / "work" / "r" / f"{number:04}").write_bytes(b"x")
    s3_server.forget()
    deadline_s = time.monotonic() + 300
    while next(store.listed("work/r/1204"), None) is None:
        assert time.monotonic() < deadline_s
        time.sleep(0.05)
    assert [found.key for found in store.listed("work/r/0")] == [f"work/r/{number:04}" for number in range(1000)]
    assert sum(1 for _ in store.listed("")) == 1206


def test_writers_and_deleters_of_one_folder_do_not_disturb_each_other(
    store: Store, stored: Settings, tmp_path: Path
) -> None:
    source, failures = file_of(tmp_path, b"content"), list[BaseException]()
    stays = ["work/r/sub/stays"] if stored.store.s3_bucket else []
    for key in stays:  # rclone keeps objects in folders, and removes one that is empty while another writes to it
        store.write(key, source)

    def come_and_go(name: str) -> None:
        try:
            for number in range(15):
                store.write(f"work/r/sub/{name}.{number}", source)
                assert b"".join(store.read(f"work/r/sub/{name}.{number}")) == b"content"
                store.delete(f"work/r/sub/{name}.{number}")
        except BaseException as error:
            failures.append(error)

    threads = [threading.Thread(target=come_and_go, args=(name,)) for name in "abcd"]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failures == []
    assert [found.key for found in store.listed("")] == stays


@pytest.mark.whole
def test_a_writer_killed_at_any_moment_leaves_whole_objects_only(
    stored: Settings, behind: Path, tmp_path: Path
) -> None:
    """Catches alone an object that a `kill -9` left half written."""
    content = random.Random(2).randbytes(LARGE_BYTES)
    source = file_of(tmp_path, content)
    store, seen, chance = open_store(stored), 0, random.Random(3)
    for _ in range(2):
        writer = start_writer(stored, source)
        assert writer.stdout is not None
        writer.stdout.readline()
        time.sleep(chance.uniform(0.0, 0.3))
        writer.send_signal(signal.SIGKILL)
        writer.communicate()
        wait_until_quiet(behind)
        for found in store.listed(""):
            assert hashlib.sha256(b"".join(store.read(found.key))).digest() == hashlib.sha256(content).digest()
            store.delete(found.key)
            seen += 1
        store.tidy(0.0)
    assert seen >= 2
    assert files_in(behind) == []


def start_writer(settings: Settings, source: Path) -> subprocess.Popen[str]:
    environment = {**os.environ, "STONE_DATA_FOLDER": str(settings.root)}
    for name in ("s3_bucket", "s3_endpoint", "s3_key_id"):
        environment[f"STONE_STORE__{name.upper()}"] = getattr(settings.store, name)
    environment["STONE_STORE__S3_SECRET"] = settings.store.s3_secret.get_secret_value()
    command = [sys.executable, "-c", WRITE_FOR_EVER, str(source)]
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)


def wait_until_quiet(folder: Path) -> None:
    """The S3 server needs a moment to notice that a client is gone."""
    deadline_s = time.monotonic() + 300
    before = None
    while (now := [(path.as_posix(), path.stat().st_size) for path in files_in(folder)]) != before:
        assert time.monotonic() < deadline_s
        before = now
        time.sleep(0.3)


def files_in(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.is_file()]


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
    with refused_as("store_unavailable", match=settings.s3_endpoint):
        store.write("blobs/a", source)
    with refused_as("store_unavailable"):
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
@pytest.mark.parametrize("answer_bytes", [40, 900])
def test_a_read_that_never_gets_further_ends(
    s3_settings: StoreSettings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, answer_bytes: int
) -> None:
    monkeypatch.setattr(s3, "RESUMES", 2)
    source = tmp_path / "source"
    source.write_bytes(b"x" * MIB)
    S3Store(make_settings(tmp_path, store=s3_settings)).write("blobs/a", source)
    with unreliable(s3_settings, answer_bytes=answer_bytes) as (settings, _):
        store = S3Store(make_settings(tmp_path / "other", store=settings))
        with refused_as("store_unavailable"):
            b"".join(store.read("blobs/a"))
        with refused_as("store_unavailable"):
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


DISK_BYTES = 4 * MIB


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A filesystem of 4 MiB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    if os.geteuid() != 0:
        pytest.skip("only root can mount a small filesystem")
    command = ["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "tmpfs", str(folder)]
    mounted = subprocess.run(command, check=False, capture_output=True, text=True)
    if mounted.returncode:
        pytest.skip(f"this machine lets nobody mount a tmpfs: {mounted.stderr.strip()}")
    yield folder
    subprocess.run(["umount", "--lazy", str(folder)], check=True)


def sized(folder: Path, size_bytes: int) -> Path:
    path = folder / f"source-{size_bytes}"
    path.write_bytes(b"x" * size_bytes)
    return path


@pytest.mark.parametrize("act", ["write", "adopt"])
def test_a_full_folder_refuses_keeps_nothing_half_and_takes_again_what_fits(
    disk: Path, tmp_path: Path, act: str
) -> None:
    store = FolderStore(disk / "store")
    place = getattr(store, act)
    place("blobs/first", sized(tmp_path, 3 * MIB))
    with pytest.raises(StoreFullError, match="the platform's disk has"):
        place("blobs/second", sized(tmp_path, 2 * MIB))
    assert [path.name for path in disk.rglob("*") if path.is_file()] == ["first"]
    store.delete("blobs/first")
    place("blobs/second", sized(tmp_path, 2 * MIB))
    assert store.size_bytes("blobs/second") == 2 * MIB


def test_content_that_did_not_fit_leaves_nothing_to_collect_later(
    disk: Path, platform: Platform, tmp_path: Path
) -> None:
    store = FolderStore(disk / "store")
    settings = platform.settings.model_copy(update={"store": StoreSettings(grace_s=-3600.0)})
    full = Platform(settings, platform.database, store)
    with pytest.raises(StoreFullError):
        prepare(store, platform.database, sized(tmp_path, 5 * MIB))
    collect_garbage(full)
    with platform.database.reading() as session:
        assert session.scalar(select(func.count()).select_from(LooseObject)) == 0
    prepared = prepare(store, platform.database, sized(tmp_path, 2 * MIB))
    with platform.database.transaction() as session:
        assert link(session, prepared).size_bytes == 2 * MIB


def test_a_full_mirror_refuses_and_keeps_nothing_half(disk: Path, s3_settings: StoreSettings, tmp_path: Path) -> None:
    one, other = make_settings(tmp_path, store=s3_settings), make_settings(disk, store=s3_settings)
    here = Workspace(S3Store(one), one, "run")
    sized(here.folder, 5 * MIB)
    here.push("")
    there = Workspace(S3Store(other), other, "run")
    with pytest.raises(StoreFullError, match=str(disk)):
        there.pull("")
    assert list(there.folder.iterdir()) == []
