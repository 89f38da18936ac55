"""Uploads over HTTP: refusals first, then what tus 1.0 promises."""

import base64
from collections.abc import Iterator
from dataclasses import replace

import httpx
import pytest

from services.runtime.orm import new_id
from services.runtime.platform import Platform
from services.runtime.settings import ApiSettings, UploadSettings
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
    shown,
)


@pytest.mark.parametrize("method", ["POST", "GET"])
def test_nobody_may_neither_create_nor_list(api: httpx.Client, method: str) -> None:
    assert code_of(api.request(method, UPLOADS, headers=TUS)) == (401, "unauthenticated")


@pytest.mark.parametrize("method", ["PATCH", "DELETE", "GET", "POST"])
def test_nobody_may_touch_an_upload(api: httpx.Client, curator: Person, method: str) -> None:
    where = created(api, curator, 10)
    assert code_of(api.request(method, where, headers=PIECE)) == (401, "unauthenticated")


def test_a_participant_and_a_token_that_only_reads_may_not_upload(
    api: httpx.Client, platform: Platform, participant: Person
) -> None:
    reader = person(platform, "curator", scopes=["read"])
    for caller in (participant, reader):
        assert code_of(create(api, caller, 10)) == (403, "forbidden")
        reply = api.post(f"{UPLOADS}/form", files={"file": b"x"}, headers=caller.headers)
        assert code_of(reply) == (403, "forbidden")


@pytest.mark.parametrize("role", ["curator", "administrator"])
def test_somebody_elses_upload_does_not_exist(
    api: httpx.Client, platform: Platform, curator: Person, role: str
) -> None:
    where, other = created(api, curator, len(CONTENT)), person(platform, role)
    for path in (where, f"{UPLOADS}/{new_id()}"):
        assert ask(api, other, path).status_code == 404
        assert code_of(patch(api, other, path, 0, CONTENT)) == (404, "upload_missing")
        assert code_of(api.delete(path, headers={**TUS, **other.headers})) == (404, "upload_missing")
        assert code_of(api.get(path, headers=other.headers)) == (404, "upload_missing")
    assert api.get(UPLOADS, headers=other.headers).json()["items"] == []
    assert offset_of(api, curator, where) == 0


@pytest.mark.parametrize("version", ["", "0.2.2", "1.0.1"])
def test_another_version_of_tus_is_refused_with_ours(api: httpx.Client, curator: Person, version: str) -> None:
    where = created(api, curator, 10)
    headers = {**curator.headers, "Upload-Length": "1", **({"Tus-Resumable": version} if version else {})}
    for method, path in (("POST", UPLOADS), ("PATCH", where), ("DELETE", where)):
        reply = api.request(method, path, headers=headers)
        assert code_of(reply) == (412, "tus_version")
        assert reply.headers["Tus-Version"] == "1.0.0"
    assert api.head(where, headers=headers).status_code == 412


@pytest.mark.parametrize("length", ["", "-1", "+5", "5.0", "1_0", "0x10", "1e3", "9" * 19])
def test_what_is_no_count_is_refused_as_a_length(api: httpx.Client, curator: Person, length: str) -> None:
    said = metadata(filename="a", purpose="recording")
    headers = {**TUS, **curator.headers, "Upload-Length": length, "Upload-Metadata": said}
    assert code_of(api.post(UPLOADS, headers=headers)) == (400, "bad_tus_header")


def test_a_deferred_length_and_a_concatenation_are_refused_by_name(api: httpx.Client, curator: Person) -> None:
    headers = {**TUS, **curator.headers}
    assert code_of(api.post(UPLOADS, headers={**headers, "Upload-Defer-Length": "1"})) == (400, "length_deferred")
    assert code_of(api.post(UPLOADS, headers={**headers, "Upload-Concat": "partial"})) == (400, "tus_extension")


@pytest.mark.parametrize(
    ("header", "expected"),
    [
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
    ],
)
def test_metadata_is_read_strictly(api: httpx.Client, curator: Person, header: str, expected: tuple[int, str]) -> None:
    headers = {**TUS, **curator.headers, "Upload-Length": "1", "Upload-Metadata": header}
    assert code_of(api.post(UPLOADS, headers=headers)) == expected


def test_metadata_that_clients_add_of_their_own_is_let_pass(api: httpx.Client, curator: Person) -> None:
    reply = create(api, curator, 1, filetype="application/octet-stream", relativePath="a/b")
    assert reply.status_code == 201


def test_a_target_that_is_not_yours_is_refused(api: httpx.Client, curator: Person) -> None:
    assert code_of(create(api, curator, 1, target_id=new_id())) == (404, "upload_target_missing")


@pytest.fixture
def small(platform: Platform) -> Iterator[httpx.Client]:
    """The application with narrow bounds."""
    bounds = UploadSettings(max_bytes=100_000, owner_bytes=50_000, form_bytes=20_000, idle_s=0.5)
    narrow = platform.settings.model_copy(update={"uploads": bounds})
    with client_of(replace(platform, settings=narrow)) as client:
        yield client


def test_what_is_too_large_or_over_the_quota_is_refused_with_the_figures(small: httpx.Client, curator: Person) -> None:
    assert code_of(create(small, curator, 100_001)) == (413, "upload_too_large")
    created(small, curator, 30_000)
    reply = create(small, curator, 20_001)
    assert code_of(reply) == (413, "quota_exceeded")
    assert "30000 of 50000 bytes are used and 20001 more" in reply.json()["detail"]


def test_more_than_may_wait_are_refused_until_one_is_deleted(platform: Platform, curator: Person) -> None:
    settings = platform.settings.model_copy(update={"uploads": UploadSettings(owner_waiting=2)})
    with client_of(replace(platform, settings=settings)) as api:
        where = [created(api, curator, 1), created(api, curator, 1)]
        for refused in (create(api, curator, 1), send_form(api, curator, b"x")):
            assert code_of(refused) == (409, "too_many_uploads")
            assert "2 uploads of yours are unfinished or not used yet" in refused.json()["detail"]
        assert api.delete(where[0], headers={**TUS, **curator.headers}).status_code == 204
        created(api, curator, 1)


def test_pieces_are_not_counted_as_requests_of_a_known_caller_but_all_else_is(
    platform: Platform, curator: Person
) -> None:
    settings = platform.settings.model_copy(update={"api": ApiSettings(requests_per_minute=10)})
    with client_of(replace(platform, settings=settings)) as api:
        where = created(api, curator, 40)
        assert [patch(api, curator, where, offset, b"x").status_code for offset in range(40)] == [204] * 40
        assert 429 in [ask(api, curator, where).status_code for _ in range(12)]
        assert 429 in [api.patch(where, headers=PIECE).status_code for _ in range(12)]


@pytest.mark.parametrize("offset", ["", "-1", "x", "1.0"])
def test_what_is_no_count_is_refused_as_an_offset(api: httpx.Client, curator: Person, offset: str) -> None:
    where = created(api, curator, 10)
    assert code_of(patch(api, curator, where, 0, b"a", Upload_Offset=offset)) == (400, "bad_tus_header")


def test_another_content_type_is_refused(api: httpx.Client, curator: Person) -> None:
    where = created(api, curator, 10)
    reply = patch(api, curator, where, 0, b"a", Content_Type="application/octet-stream")
    assert code_of(reply) == (415, "unsupported_media_type")


@pytest.mark.parametrize(
    "given", ["md5 CY9rzUYh03PK3k6DJie09g==", "sha1", "sha1 x", "sha1 AAAA", "sha256 " + checksum(b"a")[5:]]
)
def test_a_checksum_that_is_none_is_refused(api: httpx.Client, curator: Person, given: str) -> None:
    where = created(api, curator, 10)
    assert code_of(patch(api, curator, where, 0, b"a", Upload_Checksum=given)) == (400, "bad_tus_header")
    assert offset_of(api, curator, where) == 0


def test_what_is_spoken_is_said_to_anybody(api: httpx.Client, platform: Platform) -> None:
    reply = api.options(UPLOADS)
    assert reply.status_code == 204
    assert reply.headers["Tus-Version"] == "1.0.0"
    assert reply.headers["Tus-Max-Size"] == str(platform.settings.uploads.max_bytes)
    assert reply.headers["Tus-Checksum-Algorithm"] == "sha1,sha256"
    spoken = {"creation", "creation-with-upload", "checksum", "expiration", "termination"}
    assert set(reply.headers["Tus-Extension"].split(",")) == spoken


def test_methods_may_be_overridden_where_a_network_lets_none_through(api: httpx.Client, curator: Person) -> None:
    where = created(api, curator, len(CONTENT))
    headers = {**PIECE, **curator.headers, "Upload-Offset": "0", "X-HTTP-Method-Override": "PATCH"}
    assert api.post(where, content=CONTENT, headers=headers).status_code == 204
    assert code_of(api.post(where, headers={**headers, "X-HTTP-Method-Override": "GET"})) == (400, "bad_tus_header")
    assert api.post(where, headers={**headers, "X-HTTP-Method-Override": "DELETE"}).status_code == 204
    assert shown(api, curator, where)["state"] == "terminated"


def test_uploads_are_listed_by_pages_the_newest_first(api: httpx.Client, curator: Person) -> None:
    made = [created(api, curator, length).rpartition("/")[2] for length in (1, 2, 3)]
    first = api.get(UPLOADS, params={"limit": 2}, headers=curator.headers).json()
    rest = api.get(UPLOADS, params={"cursor": first["next"]}, headers=curator.headers).json()
    assert [item["id"] for item in first["items"] + rest["items"]] == made[::-1]
    assert rest["next"] is None
    assert api.get(UPLOADS, params={"state": "complete"}, headers=curator.headers).json()["items"] == []


def test_a_creation_repeated_under_its_key_creates_once(api: httpx.Client, curator: Person) -> None:
    said = {"Upload-Length": "5", "Upload-Metadata": metadata(filename="a", purpose="recording")}
    headers = {**TUS, **curator.headers, **said, "Idempotency-Key": "once"}
    first, second = (api.post(UPLOADS, headers=headers) for _ in range(2))
    assert first.status_code == second.status_code == 201
    assert first.headers["Location"] == second.headers["Location"]
    assert second.headers["Idempotency-Replayed"] == "true"


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
