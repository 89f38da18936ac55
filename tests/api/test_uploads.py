"""Uploads over HTTP: refusals first, then what tus 1.0 promises of bytes."""

import base64
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from email.utils import parsedate_to_datetime

import httpx
import pytest

from api.tus import body_stream
from services.runtime.orm import new_id
from services.runtime.platform import Platform
from services.runtime.settings import ApiSettings
from services.runtime.uploads.rows import find
from testing.api.serving import Person, client_of, person
from testing.api.tus import (
    CONTENT,
    FORM,
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


def test_another_version_of_tus_is_refused_with_ours(api: httpx.Client, curator: Person) -> None:
    for version in ["", "0.2.2", "1.0.1"]:
        where = created(api, curator, 10)
        headers = {**curator.headers, "Upload-Length": "1", **({"Tus-Resumable": version} if version else {})}
        for method, path in (("POST", UPLOADS), ("PATCH", where), ("DELETE", where)):
            reply = api.request(method, path, headers=headers)
            assert code_of(reply) == (412, "tus_version")
            assert reply.headers["Tus-Version"] == "1.0.0"
        assert api.head(where, headers=headers).status_code == 412


def test_what_is_no_count_is_refused_as_a_length_and_as_an_offset(api: httpx.Client, curator: Person) -> None:
    for length in ["", "-1", "+5", "5.0", "1_0", "0x10", "1e3", "9" * 19]:
        said = metadata(filename="a", purpose="recording")
        headers = {**TUS, **curator.headers, "Upload-Length": length, "Upload-Metadata": said}
        assert code_of(api.post(UPLOADS, headers=headers)) == (400, "bad_tus_header")
    where = created(api, curator, 10)
    for offset in ["", "-1", "x", "1.0"]:
        assert code_of(patch(api, curator, where, 0, b"a", Upload_Offset=offset)) == (400, "bad_tus_header")


def test_a_deferred_length_and_an_unknown_concatenation_are_refused_by_name(api: httpx.Client, curator: Person) -> None:
    headers = {**TUS, **curator.headers}
    assert code_of(api.post(UPLOADS, headers={**headers, "Upload-Defer-Length": "1"})) == (400, "length_deferred")
    assert code_of(api.post(UPLOADS, headers={**headers, "Upload-Concat": "both"})) == (400, "bad_tus_header")


def test_parts_are_joined_as_tus_says(api: httpx.Client, curator: Person) -> None:
    assert "concatenation" in api.options(UPLOADS).headers["Tus-Extension"].split(",")
    headers, where = {**TUS, **curator.headers}, []
    for content in (CONTENT[:4000], CONTENT[4000:]):
        part = {**headers, "Upload-Length": str(len(content)), "Upload-Concat": "partial"}
        where.append(api.post(UPLOADS, headers=part).headers["Location"])
        assert patch(api, curator, where[-1], 0, content).status_code == 204
    said = metadata(filename="run.mcap", purpose="recording", sha256=sha256_of(CONTENT))
    final = {**headers, "Upload-Concat": f"final;{' '.join(where)}", "Upload-Metadata": said}
    made = api.post(UPLOADS, headers=final)
    assert (made.status_code, made.headers["Upload-Offset"]) == (201, str(len(CONTENT)))
    whole = shown(api, curator, made.headers["Location"])
    assert (whole["state"], whole["sha256"], whole["purpose"]) == ("complete", sha256_of(CONTENT), "recording")
    assert code_of(api.post(UPLOADS, headers=final)) == (409, "wrong_upload_state")


def test_metadata_is_read_strictly(api: httpx.Client, curator: Person) -> None:
    for header, expected in [
        ("", (422, "bad_upload_metadata")),
        (metadata(filename="a"), (422, "bad_upload_metadata")),
        (metadata(purpose="recording"), (422, "bad_upload_metadata")),
        (metadata(filename="a", purpose="avatar"), (422, "bad_upload_metadata")),
        (metadata(filename="../a", purpose="recording"), (422, "bad_upload_metadata")),
        (metadata(filename="a\x00b", purpose="recording"), (422, "bad_upload_metadata")),
        (metadata(filename="a", purpose="recording", sha256="12"), (422, "bad_upload_metadata")),
        (metadata(filename="a", purpose="recording", target_id="../x"), (422, "bad_upload_metadata")),
        ("filename " + base64.b64encode(b"\xff").decode() + ",purpose cmVjb3JkaW5n", (422, "bad_upload_metadata")),
        ("filename not-base64!", (400, "bad_tus_header")),
        ("filename YQ==,filename Yg==", (400, "bad_tus_header")),
        ("file name YQ==", (400, "bad_tus_header")),
        (",", (400, "bad_tus_header")),
        ("a " + "QUFB" * 3000, (400, "bad_tus_header")),
        (",".join(f"k{number}" for number in range(33)), (400, "bad_tus_header")),
    ]:
        headers = {**TUS, **curator.headers, "Upload-Length": "1", "Upload-Metadata": header}
        assert code_of(api.post(UPLOADS, headers=headers)) == expected


def test_a_target_that_is_not_yours_is_refused(api: httpx.Client, curator: Person) -> None:
    assert code_of(create(api, curator, 1, target_id=new_id())) == (404, "upload_target_missing")


def test_what_is_too_large_or_over_the_quota_is_refused_with_the_figures(narrow: httpx.Client, curator: Person) -> None:
    assert code_of(create(narrow, curator, 100_001)) == (413, "upload_too_large")
    created(narrow, curator, 30_000)
    reply = create(narrow, curator, 20_001)
    assert code_of(reply) == (413, "quota_exceeded")
    assert "30000 of 50000 bytes are used and 20001 more" in reply.json()["detail"]


def test_pieces_are_not_counted_as_requests_of_a_known_caller_but_all_else_is(
    platform: Platform, curator: Person
) -> None:
    settings = platform.settings.model_copy(update={"api": ApiSettings(requests_per_minute=10)})
    with client_of(replace(platform, settings=settings)) as api:
        where = created(api, curator, 40)
        assert [patch(api, curator, where, offset, b"x").status_code for offset in range(40)] == [204] * 40
        assert 429 in [ask(api, curator, where).status_code for _ in range(12)]
        assert 429 in [api.patch(where, headers=PIECE).status_code for _ in range(12)]


def test_another_content_type_is_refused(api: httpx.Client, curator: Person) -> None:
    where = created(api, curator, 10)
    reply = patch(api, curator, where, 0, b"a", Content_Type="application/octet-stream")
    assert code_of(reply) == (415, "unsupported_media_type")


def test_a_checksum_that_is_none_is_refused(api: httpx.Client, curator: Person) -> None:
    for given in ["md5 CY9rzUYh03PK3k6DJie09g==", "sha1", "sha1 x", "sha1 AAAA", "sha256 " + checksum(b"a")[5:]]:
        where = created(api, curator, 10)
        assert code_of(patch(api, curator, where, 0, b"a", Upload_Checksum=given)) == (400, "bad_tus_header")
        assert offset_of(api, curator, where) == 0


def test_what_is_spoken_is_said_to_anybody(api: httpx.Client, platform: Platform) -> None:
    reply = api.options(UPLOADS)
    assert reply.status_code == 204
    assert reply.headers["Tus-Version"] == "1.0.0"
    assert reply.headers["Tus-Max-Size"] == str(platform.settings.uploads.max_bytes)
    assert reply.headers["Tus-Checksum-Algorithm"] == "sha1,sha256"
    spoken = {"creation", "creation-with-upload", "checksum", "concatenation", "expiration", "termination"}
    assert set(reply.headers["Tus-Extension"].split(",")) == spoken


def test_methods_may_be_overridden_where_a_network_lets_none_through(api: httpx.Client, curator: Person) -> None:
    where = created(api, curator, len(CONTENT))
    headers = {**PIECE, **curator.headers, "Upload-Offset": "0", "X-HTTP-Method-Override": "PATCH"}
    assert api.post(where, content=CONTENT, headers=headers).status_code == 204
    assert code_of(api.post(where, headers={**headers, "X-HTTP-Method-Override": "GET"})) == (400, "bad_tus_header")
    assert api.post(where, headers={**headers, "X-HTTP-Method-Override": "DELETE"}).status_code == 204
    assert shown(api, curator, where)["state"] == "terminated"


def test_a_form_that_is_none_is_refused(api: httpx.Client, curator: Person) -> None:
    where = f"{UPLOADS}/form"
    plain = api.post(where, content=b"x", headers={**curator.headers, "Content-Type": "text/plain"})
    assert code_of(plain) == (415, "unsupported_media_type")
    broken = {**curator.headers, "Content-Type": "multipart/form-data"}
    assert code_of(api.post(where, content=b"x", headers=broken)) == (422, "bad_form")
    no_file = api.post(where, data=FORM, files={"other": b"x"}, headers=curator.headers)
    assert code_of(no_file) == (422, "bad_form")
    two = [("file", b"x"), ("file", b"y")]
    assert code_of(api.post(where, data=FORM, files=two, headers=curator.headers)) == (422, "bad_form")
    assert code_of(send_form(api, curator, b"x", admin="1")) == (422, "bad_form")
    assert code_of(send_form(api, curator, b"x", target_id="y" * 2000)) == (422, "bad_form")
    assert code_of(send_form(api, curator, b"x", purpose="avatar")) == (422, "bad_upload_metadata")


@pytest.fixture
def narrow(platform: Platform) -> Iterator[httpx.Client]:
    """The application with narrow bounds."""
    settings = platform.settings
    bounds = replace(settings.uploads, max_bytes=100_000, owner_bytes=50_000, form_bytes=20_000, idle_s=0.5)
    with client_of(replace(platform, settings=settings.model_copy(update={"uploads": bounds}))) as client:
        yield client


def test_bytes_that_do_not_belong_there_are_refused_and_not_kept(api: httpx.Client, curator: Person) -> None:
    where = created(api, curator, len(CONTENT), sha256=sha256_of(CONTENT[::-1]))
    patch(api, curator, where, 0, CONTENT[:100])
    for offset in (0, 99, 101):
        assert code_of(patch(api, curator, where, offset, CONTENT[100:])) == (409, "offset_mismatch")
    for more in (CONTENT, iter([CONTENT[:90], CONTENT])):  # announced or not
        assert code_of(patch(api, curator, where, 100, more)) == (413, "over_length")
    for algorithm in ("sha1", "sha256"):
        damaged = patch(api, curator, where, 100, CONTENT[100:], Upload_Checksum=checksum(CONTENT[101:], algorithm))
        assert code_of(damaged) == (460, "checksum_mismatch")
    assert offset_of(api, curator, where) == 100
    assert code_of(patch(api, curator, where, 100, CONTENT[100:])) == (460, "sha256_mismatch")
    assert ask(api, curator, where).status_code == 410
    assert code_of(patch(api, curator, where, 0, CONTENT[:100])) == (410, "upload_gone")
    assert shown(api, curator, where)["state"] == "failed"


def test_a_creation_whose_bytes_are_refused_leaves_nothing_behind(api: httpx.Client, curator: Person) -> None:
    said = {**PIECE, **curator.headers, "Upload-Metadata": metadata(filename="a", purpose="recording")}
    headers = {**said, "Upload-Length": "100", "Upload-Checksum": checksum(b"other")}
    assert code_of(api.post(UPLOADS, content=CONTENT[:100], headers=headers)) == (460, "checksum_mismatch")
    assert code_of(api.post(UPLOADS, content=CONTENT, headers={**said, "Upload-Length": "9"})) == (413, "over_length")
    assert {item["state"] for item in api.get(UPLOADS, headers=curator.headers).json()["items"]} == {"terminated"}


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


def test_a_client_that_falls_silent_loses_its_lock_and_keeps_its_bytes(narrow: httpx.Client, curator: Person) -> None:
    where = created(narrow, curator, len(CONTENT))
    silent = threading.Event()

    def then_nothing() -> Iterator[bytes]:
        yield CONTENT[:1000]
        silent.wait(3)
        yield b""

    reply = patch(narrow, curator, where, 0, then_nothing())
    silent.set()
    assert code_of(reply) == (408, "receive_timeout")
    assert offset_of(narrow, curator, where) == 1000
    assert patch(narrow, curator, where, 1000, CONTENT[1000:]).status_code == 204


def test_what_a_client_sent_before_it_paused_is_not_held_in_memory(
    api: httpx.Client, curator: Person, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(body_stream, "WAITING_S", 0.05)
    where = created(api, curator, len(CONTENT))
    go_on = threading.Event()

    def in_two() -> Iterator[bytes]:
        yield CONTENT[:1000]
        go_on.wait(300)
        yield CONTENT[1000:]

    replies: list[httpx.Response] = []
    sender = threading.Thread(target=lambda: replies.append(patch(api, curator, where, 0, in_two())))
    sender.start()
    try:
        deadline = time.monotonic() + 30
        while offset_of(api, curator, where) == 0:
            assert time.monotonic() < deadline, "what came is not written"
            time.sleep(0.01)
        assert offset_of(api, curator, where) == 1000
    finally:
        go_on.set()
        sender.join(300)
    assert replies[0].status_code == 204
    assert shown(api, curator, where)["state"] == "complete"


def test_a_file_arrives_in_pieces(placed: Platform) -> None:
    owner = person(placed, "curator")
    with client_of(placed) as api:
        reply = create(api, owner, len(CONTENT), sha256=sha256_of(CONTENT), filename="Süd.mcap")
        where = reply.headers["Location"]
        assert (reply.headers["Tus-Resumable"], reply.headers["Upload-Offset"]) == ("1.0.0", "0")
        assert parsedate_to_datetime(reply.headers["Upload-Expires"]).timestamp() > 0
        for offset in range(0, len(CONTENT), 3000):
            reply = patch(api, owner, where, offset, CONTENT[offset : offset + 3000])
            assert reply.status_code == 204, reply.text
            assert int(reply.headers["Upload-Offset"]) == min(offset + 3000, len(CONTENT))
            asked = ask(api, owner, where)
            assert asked.headers["Upload-Offset"] == reply.headers["Upload-Offset"]
            assert asked.headers["Cache-Control"] == "no-store"
        state = shown(api, owner, where)
    assert (state["state"], state["sha256"], state["filename"]) == ("complete", sha256_of(CONTENT), "Süd.mcap")
    assert kept(placed, find(placed.database, state["id"], owner.user_id)) == CONTENT


def test_a_file_arrives_with_its_creation(api: httpx.Client, curator: Person) -> None:
    said = {**PIECE, **curator.headers, "Upload-Metadata": metadata(filename="a", purpose="recording")}
    whole = api.post(UPLOADS, content=CONTENT, headers={**said, "Upload-Length": str(len(CONTENT))})
    assert (whole.status_code, whole.headers["Upload-Offset"]) == (201, str(len(CONTENT)))
    part = api.post(UPLOADS, content=CONTENT[:99], headers={**said, "Upload-Length": str(len(CONTENT))})
    assert (part.status_code, part.headers["Upload-Offset"]) == (201, "99")
    assert patch(api, curator, part.headers["Location"], 99, CONTENT[99:]).status_code == 204


def test_a_form_that_is_too_large_or_not_the_declared_file_is_refused(narrow: httpx.Client, curator: Person) -> None:
    assert send_form(narrow, curator, b"x" * 200_000).status_code == 413
    assert code_of(send_form(narrow, curator, b"x" * 20_001)) == (413, "upload_too_large")
    assert code_of(send_form(narrow, curator, b"x", sha256=sha256_of(b"y"))) == (460, "sha256_mismatch")
    assert create(narrow, curator, 50_000).status_code == 201  # nothing of it was charged


def test_a_small_file_arrives_by_a_form(api: httpx.Client, platform: Platform, curator: Person) -> None:
    reply = send_form(api, curator, CONTENT, sha256=sha256_of(CONTENT).upper())
    assert reply.status_code == 201
    body = reply.json()
    assert (body["state"], body["sha256"], body["filename"]) == ("complete", sha256_of(CONTENT), "a.mcap")
    assert reply.headers["Location"] == f"{UPLOADS}/{body['id']}"
    assert kept(platform, find(platform.database, body["id"], curator.user_id)) == CONTENT
