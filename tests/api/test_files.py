"""Files: whole, in ranges, or not at all; never a byte of anything else."""

from collections.abc import Mapping
from hashlib import sha256
from typing import Any

import httpx
import pytest

from services.runtime.platform import Platform
from testing.api.serving import Person, person
from testing.worlds.made import NOBODY, Labels, labels, sequence

URL = "/api/v1/sequences"


@pytest.fixture
def forest(api: httpx.Client, curator: Person) -> dict[str, Any]:
    return sequence(api, curator)


@pytest.fixture
def made(platform: Platform, forest: Mapping[str, Any]) -> Labels:
    return labels(platform, forest)


def mesh(api: httpx.Client, caller: Person, forest: Mapping[str, Any], **headers: str) -> httpx.Response:
    spelled = {key.replace("_", "-"): value for key, value in headers.items()}
    return api.get(f"{URL}/{forest['id']}/mesh", headers=caller.headers | spelled)


@pytest.mark.parametrize("name", ["report", "mesh", "previews/bev.png", "frames"])
def test_files_are_their_owners(
    api: httpx.Client, platform: Platform, curator: Person, forest: Mapping[str, Any], made: Labels, name: str
) -> None:
    path = f"{URL}/{forest['id']}/{name}"
    assert api.get(path).status_code == 401
    assert api.get(path, headers=person(platform, "curator").headers).status_code == 404
    assert api.get(path, headers=person(platform, "participant").headers).status_code == 404
    assert api.get(path, headers=person(platform, "administrator").headers).status_code == 200
    assert api.get(path, headers=curator.headers).status_code == 200


@pytest.mark.parametrize("name", ["report", "mesh", "previews/bev.png", "frames"])
def test_before_there_are_labels_there_are_no_files(
    api: httpx.Client, curator: Person, forest: Mapping[str, Any], name: str
) -> None:
    answer = api.get(f"{URL}/{forest['id']}/{name}", headers=curator.headers)
    assert (answer.status_code, answer.json()["code"]) == (404, "not_found")


@pytest.mark.parametrize(
    "name", ["none.png", "report.json", "labels", "..%2Freport.json", "labels%2F000000.pack", "%00.png", "a" * 99]
)
def test_a_preview_is_a_picture_and_nothing_else(
    api: httpx.Client, curator: Person, forest: Mapping[str, Any], made: Labels, name: str
) -> None:
    assert api.get(f"{URL}/{forest['id']}/previews/{name}", headers=curator.headers).status_code in (404, 422)


@pytest.mark.parametrize("asked", ["bytes=10244-", "bytes=99999-", "bytes=99999-100000", "bytes=-0"])
def test_a_range_behind_the_end_is_refused(
    api: httpx.Client, curator: Person, forest: Mapping[str, Any], made: Labels, asked: str
) -> None:
    answer = mesh(api, curator, forest, Range=asked)
    assert (answer.status_code, answer.json()["code"]) == (416, "range_not_satisfiable")
    assert answer.headers["content-range"] == "bytes */10244"


@pytest.mark.parametrize(
    ("asked", "start", "stop"),
    [
        ("bytes=0-0", 0, 1), ("bytes=0-", 0, 10244), ("bytes=4-9", 4, 10), ("bytes=10243-", 10243, 10244),
        ("bytes=10000-99999999", 10000, 10244), ("bytes=-1", 10243, 10244), ("bytes=-99999", 0, 10244),
    ],
)  # fmt: skip
def test_a_range_is_exactly_that(
    api: httpx.Client, curator: Person, forest: Mapping[str, Any], made: Labels, asked: str, start: int, stop: int
) -> None:
    answer = mesh(api, curator, forest, Range=asked)
    assert (answer.status_code, answer.content) == (206, made.files["mesh.ply"][start:stop])
    assert answer.headers["content-range"] == f"bytes {start}-{stop - 1}/10244"
    assert answer.headers["content-length"] == str(stop - start)


@pytest.mark.parametrize(
    "asked",
    [
        "bytes=5-4", "bytes=-", "bytes=0-1,3-4", "bytes=a-b", "lines=0-1", "bytes 0-1", "bytes=0x0-1", "",
        "bytes=" + "9" * 5000 + "-",
    ],
)  # fmt: skip
def test_a_range_that_says_nothing_is_answered_with_the_whole(
    api: httpx.Client, curator: Person, forest: Mapping[str, Any], made: Labels, asked: str
) -> None:
    answer = mesh(api, curator, forest, Range=asked)
    assert (answer.status_code, answer.content) == (200, made.files["mesh.ply"])
    assert "content-range" not in answer.headers


def test_a_range_of_what_has_changed_is_answered_with_the_whole(
    api: httpx.Client, curator: Person, forest: Mapping[str, Any], made: Labels
) -> None:
    tag = mesh(api, curator, forest).headers["etag"]
    same = mesh(api, curator, forest, Range="bytes=0-3", If_Range=tag)
    other = mesh(api, curator, forest, Range="bytes=0-3", If_Range='"0"')
    weak = mesh(api, curator, forest, Range="bytes=0-3", If_Range=f"W/{tag}")
    assert (same.status_code, same.content) == (206, b"ply\n")
    assert other.status_code == weak.status_code == 200
    assert len(other.content) == len(weak.content) == 10244


def test_what_the_caller_has_is_not_sent_again(
    api: httpx.Client, curator: Person, forest: Mapping[str, Any], made: Labels
) -> None:
    tag = f'"{sha256(made.files["mesh.ply"]).hexdigest()}"'
    whole = mesh(api, curator, forest)
    assert whole.headers["etag"] == tag
    for named in (tag, f"W/{tag}", f'"0", {tag}', "*"):
        again = mesh(api, curator, forest, If_None_Match=named, Range="bytes=0-3")
        assert (again.status_code, again.content) == (304, b"")
        assert again.headers["etag"] == tag
    assert mesh(api, curator, forest, If_None_Match='"0"').status_code == 200


def test_each_file_says_what_it_is_and_is_not_run_by_a_browser(
    api: httpx.Client, curator: Person, forest: Mapping[str, Any], made: Labels
) -> None:
    kinds = {
        "report": ("application/json", "inline", "report.json"),
        "mesh": ("model/ply", "attachment", "mesh.ply"),
        "previews/bev.png": ("image/png", "inline", "bev.png"),
    }
    for path, (media_type, shown, name) in kinds.items():
        answer = api.get(f"{URL}/{forest['id']}/{path}", headers=curator.headers)
        assert answer.content == made.files[name]
        assert answer.headers["content-type"] == media_type
        assert answer.headers["content-length"] == str(len(made.files[name]))
        assert answer.headers["content-disposition"].startswith(f'{shown}; filename="forest-{name}"')
        assert answer.headers["accept-ranges"] == "bytes"
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert "sandbox" in answer.headers["content-security-policy"]
        assert answer.headers["cache-control"] == "private, no-cache"


def test_the_newest_labels_count(
    api: httpx.Client, platform: Platform, curator: Person, forest: Mapping[str, Any], made: Labels
) -> None:
    newest = labels(platform, forest, seed=b"n")
    assert mesh(api, curator, forest).content == newest.files["mesh.ply"] != made.files["mesh.ply"]
    for token, content in newest.frames.items():
        assert api.get(f"/api/v1/frames/{token}/labels.npz", headers=curator.headers).content == content


def test_frames_come_in_the_order_of_time_page_by_page(api_on: httpx.Client, platform_on: Platform) -> None:
    ada = person(platform_on, "curator")
    forest = sequence(api_on, ada)
    made = labels(platform_on, forest, frames=7)
    path, seen, cursor = f"{URL}/{forest['id']}/frames", [], None
    while True:
        query = {"limit": 3, **({"cursor": cursor} if cursor else {})}
        body = api_on.get(path, params=query, headers=ada.headers).json()
        seen += body["items"]
        cursor = body["next"]
        if cursor is None:
            break
    assert [frame["token"] for frame in seen] == list(made.frames)
    assert [frame["ordinal"] for frame in seen] == list(range(7))
    assert sorted(frame["stamp_ns"] for frame in seen) == [frame["stamp_ns"] for frame in seen]


def test_a_frames_labels_are_its_range_of_the_pack(api_on: httpx.Client, platform_on: Platform) -> None:
    ada = person(platform_on, "curator")
    forest = sequence(api_on, ada)
    made = labels(platform_on, forest)
    for ordinal, (token, content) in enumerate(made.frames.items()):
        answer = api_on.get(f"/api/v1/frames/{token}/labels.npz", headers=ada.headers)
        assert (answer.status_code, answer.content) == (200, content)
        assert answer.headers["etag"] == f'"{sha256(content).hexdigest()}"'
        part = api_on.get(f"/api/v1/frames/{token}/labels.npz", headers=ada.headers | {"Range": "bytes=2-"})
        assert (part.status_code, part.content) == (206, content[2:])
        beyond = {"Range": f"bytes={len(content)}-"}
        assert api_on.get(f"/api/v1/frames/{token}/labels.npz", headers=ada.headers | beyond).status_code == 416
        shown = api_on.get(f"/api/v1/frames/{token}", headers=ada.headers).json()
        assert (shown["ordinal"], shown["sequence_id"], shown["labels_bytes"]) == (ordinal, forest["id"], len(content))


def test_a_token_that_two_owners_share_opens_to_each_their_own(api_on: httpx.Client, platform_on: Platform) -> None:
    ada, bob, eve = (person(platform_on, "curator") for _ in range(3))
    hers = labels(platform_on, sequence(api_on, ada), seed=b"a")
    his = labels(platform_on, sequence(api_on, bob), seed=b"b")
    assert list(hers.frames) == list(his.frames), "equal names and stamps make equal tokens"
    token = next(iter(hers.frames))
    path = f"/api/v1/frames/{token}/labels.npz"
    assert api_on.get(path, headers=ada.headers).content == hers.frames[token]
    assert api_on.get(path, headers=bob.headers).content == his.frames[token]
    for below in ("", "/labels.npz"):
        assert api_on.get(f"/api/v1/frames/{token}{below}", headers=eve.headers).status_code == 404
        assert api_on.get(f"/api/v1/frames/{token}{below}").status_code == 401


def test_a_frame_that_the_newest_labels_do_not_have_is_gone(
    api: httpx.Client, platform: Platform, curator: Person, forest: Mapping[str, Any]
) -> None:
    old = labels(platform, forest, frames=3)
    labels(platform, forest, frames=2, seed=b"n")
    tokens = list(old.frames)
    found = [api.get(f"/api/v1/frames/{token}", headers=curator.headers).status_code for token in tokens]
    assert found == [200, 200, 404]
    assert api.get(f"/api/v1/frames/{NOBODY}", headers=curator.headers).status_code == 404
    assert api.get("/api/v1/frames/..%2F/labels.npz", headers=curator.headers).status_code in (404, 422)
