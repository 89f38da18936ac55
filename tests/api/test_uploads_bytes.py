"""Bytes over HTTP: what tus 1.0 promises of them, in a folder and in the store."""

import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from email.utils import parsedate_to_datetime

import httpx
import pytest
from sqlalchemy import update

from services.runtime.orm import Upload
from services.runtime.platform import Platform
from services.runtime.uploads import expire
from services.runtime.uploads.rows import find
from testing.api.serving import Person, client_of, person
from testing.api.tus import (
    CONTENT,
    PIECE,
    TUS,
    UPLOADS,
    ask,
    checksum,
    code_of,
    create,
    created,
    metadata,
    offset_of,
    patch,
    send_form,
    sha256_of,
    shown,
)
from tests.services.runtime.uploads.sending import kept


@pytest.fixture
def api(placed: Platform) -> Iterator[httpx.Client]:
    with client_of(placed) as client:
        yield client


@pytest.fixture
def api_on(placed_on: Platform) -> Iterator[httpx.Client]:
    with client_of(placed_on) as client:
        yield client


@pytest.fixture
def small(placed: Platform) -> Iterator[httpx.Client]:
    """The application with narrow bounds."""
    settings = placed.settings
    bounds = replace(settings.uploads, max_bytes=100_000, owner_bytes=50_000, form_bytes=20_000, idle_s=0.5)
    with client_of(replace(placed, settings=settings.model_copy(update={"uploads": bounds}))) as client:
        yield client


def test_a_wrong_offset_is_a_conflict(api: httpx.Client, curator: Person) -> None:
    where = created(api, curator, len(CONTENT))
    patch(api, curator, where, 0, CONTENT[:100])
    for offset in (0, 99, 101):
        assert code_of(patch(api, curator, where, offset, CONTENT[100:])) == (409, "offset_mismatch")
    assert offset_of(api, curator, where) == 100


def test_more_than_was_declared_is_refused_announced_or_not(api: httpx.Client, curator: Person) -> None:
    where = created(api, curator, 100)
    assert code_of(patch(api, curator, where, 0, CONTENT)) == (413, "over_length")
    assert code_of(patch(api, curator, where, 0, iter([CONTENT[:90], CONTENT]))) == (413, "over_length")
    assert offset_of(api, curator, where) == 0


@pytest.mark.parametrize("algorithm", ["sha1", "sha256"])
def test_bytes_that_were_damaged_on_the_way_are_cut_off_again(
    api: httpx.Client, curator: Person, algorithm: str
) -> None:
    where = created(api, curator, len(CONTENT), sha256=sha256_of(CONTENT))
    patch(api, curator, where, 0, CONTENT[:100])
    right = checksum(CONTENT[100:], algorithm)
    damaged = CONTENT[100:-1] + b"?"
    assert code_of(patch(api, curator, where, 100, damaged, Upload_Checksum=right)) == (460, "checksum_mismatch")
    assert offset_of(api, curator, where) == 100
    assert patch(api, curator, where, 100, CONTENT[100:], Upload_Checksum=right).status_code == 204
    assert shown(api, curator, where)["sha256"] == sha256_of(CONTENT)


def test_a_whole_that_is_not_the_declared_file_fails(api: httpx.Client, curator: Person) -> None:
    where = created(api, curator, 100, sha256=sha256_of(b"another"))
    assert code_of(patch(api, curator, where, 0, CONTENT[:100])) == (460, "sha256_mismatch")
    assert ask(api, curator, where).status_code == 410
    assert code_of(patch(api, curator, where, 0, CONTENT[:100])) == (410, "upload_gone")
    assert shown(api, curator, where)["state"] == "failed"


def test_a_second_writer_is_told_that_it_is_locked_while_everybody_else_is_answered(
    api: httpx.Client, curator: Person
) -> None:
    large = CONTENT * 1000  # more than what is held in memory before it is written
    where = created(api, curator, len(large))
    go_on = threading.Event()

    def slowly() -> Iterator[bytes]:
        yield large[:-10]
        go_on.wait(300)
        yield large[-10:]

    replies: list[httpx.Response] = []
    first = threading.Thread(target=lambda: replies.append(patch(api, curator, where, 0, slowly())))
    first.start()
    try:
        deadline = time.monotonic() + 300
        while offset_of(api, curator, where) == 0:
            assert time.monotonic() < deadline, "the first writer does not write"
            time.sleep(0.01)
        assert code_of(patch(api, curator, where, 0, b"")) == (423, "upload_locked")
        assert code_of(api.delete(where, headers={**TUS, **curator.headers})) == (423, "upload_locked")
        assert api.get(UPLOADS, headers=curator.headers).status_code == 200
    finally:
        go_on.set()
        first.join(300)
    assert replies[0].status_code == 204
    assert shown(api, curator, where)["state"] == "complete"


def test_a_client_that_falls_silent_loses_its_lock_and_keeps_its_bytes(small: httpx.Client, curator: Person) -> None:
    where = created(small, curator, len(CONTENT))
    silent = threading.Event()

    def then_nothing() -> Iterator[bytes]:
        yield CONTENT[:1000]
        silent.wait(3)
        yield b""

    reply = patch(small, curator, where, 0, then_nothing())
    silent.set()
    assert code_of(reply) == (408, "receive_timeout")
    assert offset_of(small, curator, where) == 1000
    assert patch(small, curator, where, 1000, CONTENT[1000:]).status_code == 204


def test_a_file_arrives_in_pieces(api_on: httpx.Client, placed_on: Platform) -> None:
    owner = person(placed_on, "curator")
    reply = create(api_on, owner, len(CONTENT), sha256=sha256_of(CONTENT), filename="Süd.mcap")
    where = reply.headers["Location"]
    assert reply.headers["Tus-Resumable"] == "1.0.0"
    assert reply.headers["Upload-Offset"] == "0"
    assert parsedate_to_datetime(reply.headers["Upload-Expires"]).timestamp() > 0
    for offset in range(0, len(CONTENT), 3000):
        reply = patch(api_on, owner, where, offset, CONTENT[offset : offset + 3000])
        assert reply.status_code == 204, reply.text
        assert int(reply.headers["Upload-Offset"]) == min(offset + 3000, len(CONTENT))
        asked = ask(api_on, owner, where)
        assert asked.headers["Upload-Offset"] == reply.headers["Upload-Offset"]
        assert asked.headers["Cache-Control"] == "no-store"
    state = shown(api_on, owner, where)
    assert (state["state"], state["sha256"], state["filename"]) == ("complete", sha256_of(CONTENT), "Süd.mcap")
    assert kept(placed_on, find(placed_on.database, state["id"], owner.user_id)) == CONTENT


def test_a_file_arrives_with_its_creation(api: httpx.Client, curator: Person) -> None:
    said = {**PIECE, **curator.headers, "Upload-Metadata": metadata(filename="a", purpose="recording")}
    whole = api.post(UPLOADS, content=CONTENT, headers={**said, "Upload-Length": str(len(CONTENT))})
    assert (whole.status_code, whole.headers["Upload-Offset"]) == (201, str(len(CONTENT)))
    part = api.post(UPLOADS, content=CONTENT[:99], headers={**said, "Upload-Length": str(len(CONTENT))})
    assert (part.status_code, part.headers["Upload-Offset"]) == (201, "99")
    assert patch(api, curator, part.headers["Location"], 99, CONTENT[99:]).status_code == 204


def test_a_creation_whose_bytes_are_refused_leaves_nothing_behind(api: httpx.Client, curator: Person) -> None:
    said = {**PIECE, **curator.headers, "Upload-Metadata": metadata(filename="a", purpose="recording")}
    headers = {**said, "Upload-Length": "100", "Upload-Checksum": checksum(b"other")}
    assert code_of(api.post(UPLOADS, content=CONTENT[:100], headers=headers)) == (460, "checksum_mismatch")
    assert code_of(api.post(UPLOADS, content=CONTENT, headers={**said, "Upload-Length": "9"})) == (413, "over_length")
    assert {item["state"] for item in api.get(UPLOADS, headers=curator.headers).json()["items"]} == {"terminated"}


def test_a_file_that_is_here_already_is_not_asked_for_again(
    api: httpx.Client, platform: Platform, curator: Person
) -> None:
    where = created(api, curator, len(CONTENT))
    patch(api, curator, where, 0, CONTENT)
    again = create(api, curator, len(CONTENT), sha256=sha256_of(CONTENT))
    assert again.headers["Upload-Offset"] == str(len(CONTENT))
    assert again.headers["Location"] != where
    assert shown(api, curator, again.headers["Location"])["state"] == "complete"
    theirs = create(api, person(platform, "curator"), len(CONTENT), sha256=sha256_of(CONTENT))
    assert theirs.headers["Upload-Offset"] == "0"


def test_an_expired_upload_is_gone(api: httpx.Client, platform: Platform, curator: Person) -> None:
    where = created(api, curator, 10)
    with platform.database.transaction() as session:
        session.execute(update(Upload).values(expires_ns=1))
    assert ask(api, curator, where).status_code == 410
    assert expire(platform) == 1
    assert code_of(patch(api, curator, where, 0, b"a")) == (410, "upload_gone")
    assert shown(api, curator, where)["state"] == "expired"


def test_a_terminated_upload_is_gone_and_gives_its_bytes_back(small: httpx.Client, curator: Person) -> None:
    where = created(small, curator, 50_000)
    assert create(small, curator, 1).status_code == 413
    assert small.delete(where, headers={**TUS, **curator.headers}).status_code == 204
    assert ask(small, curator, where).status_code == 410
    assert code_of(small.delete(where, headers={**TUS, **curator.headers})) == (410, "upload_gone")
    assert create(small, curator, 50_000).status_code == 201


def test_a_form_that_is_too_large_or_not_the_declared_file_is_refused(small: httpx.Client, curator: Person) -> None:
    assert send_form(small, curator, b"x" * 200_000).status_code == 413
    assert code_of(send_form(small, curator, b"x" * 20_001)) == (413, "upload_too_large")
    assert code_of(send_form(small, curator, b"x", sha256=sha256_of(b"y"))) == (460, "sha256_mismatch")
    assert create(small, curator, 50_000).status_code == 201  # nothing of it was charged


def test_a_small_file_arrives_by_a_form(api: httpx.Client, platform: Platform, curator: Person) -> None:
    reply = send_form(api, curator, CONTENT, sha256=sha256_of(CONTENT).upper())
    assert reply.status_code == 201
    body = reply.json()
    assert (body["state"], body["sha256"], body["filename"]) == ("complete", sha256_of(CONTENT), "a.mcap")
    assert reply.headers["Location"] == f"{UPLOADS}/{body['id']}"
    assert kept(platform, find(platform.database, body["id"], curator.user_id)) == CONTENT
