"""Exports over HTTP: asked for once, downloaded whole, in ranges or file by file, by their owner; those of a public
sequence by whoever is signed in."""

import io
import tarfile
import zipfile
from base64 import b64decode
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from hashlib import sha256
from pathlib import Path
from typing import Any

import httpx
import pytest
from sqlalchemy import select

from services.runtime.access import storage_quota
from services.runtime.orm import AuditEntry, Blob, Export, ExportPack, Job, SequenceRow
from services.runtime.platform import Platform
from services.runtime.store.garbage_collection import collect_garbage
from testing.api.process import running_api
from testing.api.serving import Person, client_of, person
from testing.worlds import made as laid
from testing.worlds import published
from testing.worlds.made import export, labels, playback, sequence

URL = "/api/v1/sequences"
FILES = {
    "v1.0-trainval/sample.json": b"[]\n",
    "samples/LIDAR_TOP/n001-2026-05-03__LIDAR_TOP__1777800000000000.pcd.bin": bytes(range(256)) * 11,
    "samples/CAM_FRONT/" + "n" * 120 + ".jpg": b"\xff\xd8" + b"jpeg" * 700,
    "gts/forest/empty.npz": b"",
}


@pytest.fixture
def forest(api: httpx.Client, platform: Platform, curator: Person) -> dict[str, Any]:
    made = sequence(api, curator)
    labels(platform, made)
    return made


@pytest.fixture
def made(platform: Platform, forest: Mapping[str, Any]) -> str:
    """The path of a finished export."""
    return f"{URL}/{forest['id']}/exports/{export(platform, forest['id'], FILES)}"


def ask(api: httpx.Client, caller: Person, path: str, **headers: str) -> httpx.Response:
    return api.get(path, headers=caller.headers | {key.replace("_", "-"): value for key, value in headers.items()})


def start(api: httpx.Client, caller: Person, forest: Mapping[str, Any], form: str, **headers: str) -> httpx.Response:
    return api.post(f"{URL}/{forest['id']}/exports", json={"format": form}, headers=caller.headers | headers)


def sums() -> bytes:
    return b"".join(f"{sha256(FILES[name]).hexdigest()}  {name}\n".encode() for name in sorted(FILES))


def test_an_export_is_asked_for_once_however_often_it_is_asked_for(
    api: httpx.Client, curator: Person, forest: Mapping[str, Any]
) -> None:
    first, second = (start(api, curator, forest, "mesh") for _ in range(2))
    assert (first.status_code, second.status_code) == (202, 202)
    assert first.json() == second.json()
    shown = first.json()["export"]
    assert (shown["state"], shown["is_stale"], shown["archives"], shown["files"]) == ("queued", False, [], 0)
    assert first.json()["job"]["kind"] == "labeler.export"
    assert api.get(first.headers["Location"], headers=curator.headers).json() == shown
    listed = ask(api, curator, f"{URL}/{forest['id']}/exports").json()
    assert listed == {"items": [shown], "next": None}


def test_a_finished_export_is_not_made_again_until_the_labels_are_others(
    api: httpx.Client, platform: Platform, curator: Person, forest: Mapping[str, Any], made: str
) -> None:
    before = ask(api, curator, made).json()
    again = start(api, curator, forest, "mesh").json()
    assert (again["export"], again["job"]["state"]) == (before, "succeeded")
    labels(platform, forest, seed=b"anew")
    stale = ask(api, curator, made).json()
    assert (before["is_stale"], stale["is_stale"]) == (False, True)
    fresh = start(api, curator, forest, "mesh").json()["export"]
    assert (fresh["id"] != before["id"], fresh["is_stale"], fresh["state"]) == (True, False, "queued")
    assert ask(api, curator, f"{made}/archive").status_code == 200
    assert [one["id"] for one in api.get(f"{URL}/{forest['id']}/exports", headers=curator.headers).json()["items"]] == [
        fresh["id"], before["id"],
    ]  # fmt: skip


def test_what_cannot_be_exported_is_refused_with_its_reason(
    api: httpx.Client, curator: Person, forest: Mapping[str, Any]
) -> None:
    assert start(api, curator, forest, "obj").status_code == 422
    gone = start(api, curator, forest, "nuscenes")
    assert (gone.status_code, gone.json()["code"]) == (409, "nothing_to_export")
    assert "recording was deleted" in gone.json()["detail"]
    bare = start(api, curator, sequence(api, curator, "bare"), "mesh")
    assert (bare.status_code, bare.json()["code"]) == (409, "nothing_to_export")
    unfinished = start(api, curator, forest, "mesh").json()["export"]["id"]
    for route in ("archive", "files", "files/mesh.ply"):
        answer = ask(api, curator, f"{URL}/{forest['id']}/exports/{unfinished}/{route}")
        assert (answer.status_code, answer.json()["code"]) == (409, "export_unfinished")


@pytest.mark.parametrize("kind", ["tar", "zip"])
def test_an_archive_holds_every_file_and_is_what_its_checksum_says(
    api: httpx.Client, curator: Person, made: str, kind: str
) -> None:
    shown = {one["format"]: one for one in ask(api, curator, made).json()["archives"]}[kind]
    answer = ask(api, curator, f"{made}/archive?format={kind}")
    found = sha256(answer.content)
    assert (len(answer.content), found.hexdigest()) == (shown["size_bytes"], shown["sha256"])
    assert answer.headers["ETag"] == f'"{shown["sha256"]}"'
    assert answer.headers["Content-Length"] == str(shown["size_bytes"])
    for name in ("Content-Digest", "Repr-Digest"):
        assert b64decode(answer.headers[name].removeprefix("sha-256=:").removesuffix(":")) == found.digest()
    assert f'filename="forest-mesh.{kind}"' in answer.headers["Content-Disposition"]
    assert unpacked(answer.content, kind) == {**FILES, "sha256sum.txt": sums()}


def unpacked(content: bytes, kind: str) -> dict[str, bytes]:
    if kind == "zip":
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            return {name: archive.read(name) for name in archive.namelist()}
    with tarfile.open(fileobj=io.BytesIO(content), mode="r:") as tar:
        return {one.name: tar.extractfile(one).read() for one in tar}  # type: ignore[union-attr]


def test_an_interrupted_download_goes_on_where_it_broke_off(api: httpx.Client, curator: Person, made: str) -> None:
    for kind in ["tar", "zip"]:
        path = f"{made}/archive?format={kind}"
        whole = ask(api, curator, path)
        etag, size = whole.headers["ETag"], len(whole.content)
        for start in (1, 511, 1024, size // 2, size - 1):
            rest = ask(api, curator, path, range=f"bytes={start}-", if_range=etag)
            assert (rest.status_code, rest.headers["Content-Range"]) == (206, f"bytes {start}-{size - 1}/{size}")
            assert rest.content == whole.content[start:]
            assert "Content-Digest" not in rest.headers
        assert ask(api, curator, path, range="bytes=-7").content == whole.content[-7:]
        other = ask(api, curator, path, range="bytes=5-", if_range='"another"')
        assert (other.status_code, other.content) == (200, whole.content)
        beyond = ask(api, curator, path, range=f"bytes={size}-")
        assert (beyond.status_code, beyond.headers["Content-Range"]) == (416, f"bytes */{size}")
        assert ask(api, curator, path, if_none_match=etag).status_code == 304


def test_a_head_says_what_a_get_would_bring(api: httpx.Client, curator: Person, made: str) -> None:
    for route in ("archive", "archive?format=zip", "files/v1.0-trainval/sample.json"):
        full = ask(api, curator, f"{made}/{route}")
        head = api.head(f"{made}/{route}", headers=curator.headers | {"Range": "bytes=0-1"})
        assert (head.status_code, head.content) == (200, b"")
        for name in ("Content-Length", "ETag", "Repr-Digest", "Content-Type", "Accept-Ranges"):
            assert head.headers[name] == full.headers[name]


def test_every_file_is_served_by_its_path(api: httpx.Client, curator: Person, made: str) -> None:
    listed = ask(api, curator, f"{made}/files").json()
    assert listed["next"] is None
    assert [one["path"] for one in listed["items"]] == [*sorted(FILES), "sha256sum.txt"]
    for one in listed["items"]:
        answer = ask(api, curator, f"{made}/files/{one['path']}")
        assert (answer.status_code, len(answer.content)) == (200, one["size_bytes"])
        assert sha256(answer.content).hexdigest() == one["sha256"]
        assert answer.headers["ETag"] == f'"{one["sha256"]}"'
        assert "attachment" in answer.headers["Content-Disposition"]
        assert answer.content == {**FILES, "sha256sum.txt": sums()}[one["path"]]
    part = ask(api, curator, f"{made}/files/samples/CAM_FRONT/{'n' * 120}.jpg", range="bytes=2-5")
    assert (part.status_code, part.content) == (206, b"jpeg")


def test_the_list_of_files_goes_on_by_its_cursor(api: httpx.Client, curator: Person, made: str) -> None:
    names, cursor = list[str](), ""
    while cursor is not None:
        page = ask(api, curator, f"{made}/files?limit=2" + (f"&cursor={cursor}" if cursor else "")).json()
        names += [one["path"] for one in page["items"]]
        cursor = page["next"]
    assert names == [*sorted(FILES), "sha256sum.txt"]
    for cursor in ("LTk", "OTk5OTk5OTk5OTk5OTk5OTk5OTk5OQ", "IngiCg"):  # -9, beyond 64 bits, a text
        assert ask(api, curator, f"{made}/files?cursor={cursor}").status_code == 422
    assert ask(api, curator, f"{made}/files?cursor=OTk5").json() == {"items": [], "next": None}


def test_a_path_is_looked_up_and_nothing_else(api: httpx.Client, curator: Person, made: str) -> None:
    for path in [
        "nothing.txt",
        "v1.0-trainval",
        "..%2F..%2Freport.json",
        "%2Fetc%2Fpasswd",
        "a%00b",
        ".hidden",
        "a//b",
    ]:
        assert ask(api, curator, f"{made}/files/{path}").status_code in (404, 422)


def test_finished_exports_of_a_public_sequence_are_for_whoever_is_signed_in(
    api: httpx.Client, platform: Platform, curator: Person, forest: Mapping[str, Any], made: str
) -> None:
    played = f"{URL}/{forest['id']}/exports/{export_played(platform, forest['id'])}"
    reader = person(platform, "participant")
    with platform.database.transaction() as session:
        session.get_one(SequenceRow, forest["id"]).is_public = True
    for route in ("", "/archive", "/files", "/files/sha256sum.txt"):
        assert api.get(made + route).status_code == 401
        assert ask(api, reader, made + route).status_code == 200
        assert ask(api, reader, played + route).status_code == 404
    assert api.head(f"{made}/archive", headers=reader.headers).status_code == 200
    listed = ask(api, reader, f"{URL}/{forest['id']}/exports").json()["items"]
    assert [one["id"] for one in listed] == [made.rpartition("/")[2]]
    assert len(ask(api, curator, f"{URL}/{forest['id']}/exports").json()["items"]) == 2
    other = person(platform, "curator")
    assert start(api, other, forest, "mesh").status_code == 404
    assert api.delete(made, headers=other.headers).status_code == 404
    with platform.database.transaction() as session:
        session.get_one(Export, made.rpartition("/")[2]).finished_ns = None
    assert ask(api, reader, made).status_code == ask(api, reader, f"{made}/archive").status_code == 404


def export_played(platform: Platform, sequence_id: str) -> str:
    """The id of a playback of the sequence."""
    playback(platform, sequence_id, ["f" * 32], b"a picture")
    with platform.database.reading() as session:
        return session.scalars(select(Export.id).where(Export.format == "playback")).one()


def test_what_is_hidden_is_exported_for_nobody_else_be_the_sequence_public(
    api: httpx.Client, platform: Platform, curator: Person, forest: Mapping[str, Any], made: str
) -> None:
    with platform.database.transaction() as session:
        session.get_one(SequenceRow, forest["id"]).is_public = True
    reader = person(platform, "participant")
    assert ask(api, reader, f"{made}/archive").status_code == 200
    published.dataset(platform, person(platform, "administrator").user_id, {"test": [forest["id"]]})
    for route in ("", "/archive", "/files", "/files/sha256sum.txt"):
        assert ask(api, reader, made + route).status_code == 404
    assert ask(api, reader, f"{URL}/{forest['id']}/exports").status_code == 404
    assert ask(api, curator, f"{made}/archive").status_code == 200


def test_a_deleted_export_gives_everything_back(
    api: httpx.Client, platform: Platform, curator: Person, made: str
) -> None:
    with platform.database.reading() as session:
        kept = set(session.scalars(select(ExportPack.blob_sha256)))
        assert len(kept) > 1
        assert storage_quota.balance(session, curator.user_id) > sum(map(len, FILES.values()))
    assert ask(api, curator, f"{made}/archive").status_code == 200
    assert api.delete(made, headers=curator.headers).status_code == 204
    assert ask(api, curator, made).status_code == 404
    collect_all(platform)
    with platform.database.reading() as session:
        assert session.scalars(select(Export)).all() == []
        assert kept & set(session.scalars(select(Blob.sha256))) == set()
        assert storage_quota.balance(session, curator.user_id) == 0
        acts = session.scalars(select(AuditEntry.act).where(AuditEntry.subject_id == made.rpartition("/")[2])).all()
    assert acts == ["export.delete"]


def test_deleting_an_export_stops_its_job(
    api: httpx.Client, platform: Platform, curator: Person, forest: Mapping[str, Any]
) -> None:
    asked = start(api, curator, forest, "mesh").json()
    path = f"{URL}/{forest['id']}/exports/{asked['export']['id']}"
    assert api.delete(path, headers=curator.headers).status_code == 204
    with platform.database.reading() as session:
        assert session.get_one(Job, asked["job"]["id"]).state == "cancelled"


def collect_all(platform: Platform) -> None:
    """The collection of a platform whose grace has passed."""
    settings = platform.settings.model_copy(update={"store": type(platform.settings.store)(grace_s=-1.0)})
    collect_garbage(Platform(settings, platform.database, platform.store))


MIB = 2**20
LARGE = 64 * MIB
MORE_BYTES = 40 * MIB


@pytest.mark.whole
def test_memory_is_flat_while_archives_are_streamed(platform: Platform, curator: Person, tmp_path: Path) -> None:
    """Catches alone an archive that is held in memory while it is sent, however many download it at once."""
    with client_of(platform) as client:
        sequence = laid.sequence(client, curator)
    laid.labels(platform, sequence)
    files = {"large.bin": bytes(LARGE), **{f"small/{n:04d}.bin": b"x" * 700 for n in range(20)}}
    laid.export(platform, sequence["id"], files)
    path = f"/api/v1/sequences/{sequence['id']}/exports"
    with ExitStack() as stack:
        api = stack.enter_context(running_api(platform.settings, tmp_path / "api.log"))
        client = stack.enter_context(httpx.Client(base_url=api.url, headers=curator.headers, timeout=300))
        export = client.get(path).json()["items"][0]
        url = f"{path}/{export['id']}/archive?format=zip"
        client.get(url, headers={"Range": "bytes=-1000"})
        before = api.peak_bytes()
        with ThreadPoolExecutor(2) as pool:
            found = list(pool.map(lambda _: digest(client, url), range(2)))
        after = api.peak_bytes()
    wanted = {one["format"]: one["sha256"] for one in export["archives"]}["zip"]
    assert found == [wanted] * 2
    assert after - before < MORE_BYTES


def digest(client: httpx.Client, url: str) -> str:
    found = sha256()
    with client.stream("GET", url) as answer:
        for piece in answer.iter_bytes():
            found.update(piece)
    return found.hexdigest()
