"""Files: whole, in ranges, or not at all, never a byte of anything else; pictures in the colours asked for."""

import io
from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from PIL import Image

from services.domain.sequences.previews import PreparedPreview, PreviewSubject, prepared_previews, replace_previews
from services.domain.viewer.frame_picture import of_class, png_of
from services.runtime.orm import Artefact, LabelSet, SequenceRow, new_id
from services.runtime.platform import Platform
from services.runtime.store import blobs
from stone.labels.class_colours import PALETTES, ColourName
from testing.api.serving import Person, person
from testing.worlds import made as laid
from testing.worlds.benchmark_world import labels_npz
from testing.worlds.made import NOBODY, Labels, labels, sequence, upload

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


def test_before_there_are_labels_there_are_no_files(
    api: httpx.Client, curator: Person, forest: Mapping[str, Any]
) -> None:
    for name in ["report", "mesh", "previews/bev.png", "frames"]:
        answer = api.get(f"{URL}/{forest['id']}/{name}", headers=curator.headers)
        assert (answer.status_code, answer.json()["code"]) == (404, "not_found")


def test_a_preview_is_a_picture_and_nothing_else(
    api: httpx.Client, curator: Person, forest: Mapping[str, Any], made: Labels
) -> None:
    for name in ["none.png", "report.json", "labels", "..%2Freport.json", "labels%2F000000.pack", "%00.png", "a" * 99]:
        assert api.get(f"{URL}/{forest['id']}/previews/{name}", headers=curator.headers).status_code in (404, 422)


def test_a_range_behind_the_end_is_refused(
    api: httpx.Client, curator: Person, forest: Mapping[str, Any], made: Labels
) -> None:
    for asked in ["bytes=10244-", "bytes=99999-", "bytes=99999-100000", "bytes=-0"]:
        answer = mesh(api, curator, forest, Range=asked)
        assert (answer.status_code, answer.json()["code"]) == (416, "range_not_satisfiable")
        assert answer.headers["content-range"] == "bytes */10244"


def test_a_range_is_exactly_that(api: httpx.Client, curator: Person, forest: Mapping[str, Any], made: Labels) -> None:
    for asked, start, stop in [
        ("bytes=0-0", 0, 1),
        ("bytes=0-", 0, 10244),
        ("bytes=4-9", 4, 10),
        ("bytes=10243-", 10243, 10244),
        ("bytes=10000-99999999", 10000, 10244),
        ("bytes=-1", 10243, 10244),
        ("bytes=-99999", 0, 10244),
    ]:
        answer = mesh(api, curator, forest, Range=asked)
        assert (answer.status_code, answer.content) == (206, made.files["mesh.ply"][start:stop])
        assert answer.headers["content-range"] == f"bytes {start}-{stop - 1}/10244"
        assert answer.headers["content-length"] == str(stop - start)


def test_a_range_that_says_nothing_is_answered_with_the_whole(
    api: httpx.Client, curator: Person, forest: Mapping[str, Any], made: Labels
) -> None:
    for asked in [
        "bytes=5-4",
        "bytes=-",
        "bytes=0-1,3-4",
        "bytes=a-b",
        "lines=0-1",
        "bytes 0-1",
        "bytes=0x0-1",
        "",
        "bytes=" + "9" * 5000 + "-",
    ]:
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


def test_a_frames_labels_are_its_range_of_the_pack(api: httpx.Client, platform: Platform) -> None:
    ada = person(platform, "curator")
    forest = sequence(api, ada)
    made = labels(platform, forest)
    for ordinal, (token, content) in enumerate(made.frames.items()):
        answer = api.get(f"/api/v1/frames/{token}/labels.npz", headers=ada.headers)
        assert (answer.status_code, answer.content) == (200, content)
        assert answer.headers["etag"] == f'"{sha256(content).hexdigest()}"'
        part = api.get(f"/api/v1/frames/{token}/labels.npz", headers=ada.headers | {"Range": "bytes=2-"})
        assert (part.status_code, part.content) == (206, content[2:])
        beyond = {"Range": f"bytes={len(content)}-"}
        assert api.get(f"/api/v1/frames/{token}/labels.npz", headers=ada.headers | beyond).status_code == 416
        shown = api.get(f"/api/v1/frames/{token}", headers=ada.headers).json()
        assert (shown["ordinal"], shown["sequence_id"], shown["labels_bytes"]) == (ordinal, forest["id"], len(content))


def test_a_token_that_two_owners_share_opens_to_each_their_own(api: httpx.Client, platform: Platform) -> None:
    ada, bob, eve = (person(platform, "curator") for _ in range(3))
    hers = labels(platform, sequence(api, ada), seed=b"a")
    his = labels(platform, sequence(api, bob), seed=b"b")
    assert list(hers.frames) == list(his.frames), "equal names and stamps make equal tokens"
    token = next(iter(hers.frames))
    path = f"/api/v1/frames/{token}/labels.npz"
    assert api.get(path, headers=ada.headers).content == hers.frames[token]
    assert api.get(path, headers=bob.headers).content == his.frames[token]
    for below in ("", "/labels.npz"):
        assert api.get(f"/api/v1/frames/{token}{below}", headers=eve.headers).status_code == 404
        assert api.get(f"/api/v1/frames/{token}{below}").status_code == 401


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


PAGE = b"<!doctype html><style>p{}</style><p>87</p>"


def drawn(
    platform: Platform, shown: PreviewSubject, files: dict[str, tuple[str, bytes]]
) -> tuple[PreparedPreview, ...]:
    work = Path(platform.settings.root) / f"made-{new_id()}"
    previews = prepared_previews(platform, work, ((name, *file) for name, file in files.items()))
    with platform.database.transaction() as session:
        blobs.link_all(session, (preview.blob for preview in previews))
        replace_previews(session, shown, previews)
    return previews


@pytest.fixture
def recording(api: httpx.Client, platform: Platform, curator: Person, forest: dict[str, Any]) -> dict[str, Any]:
    body = {"upload_id": upload(platform, curator)}
    answer = api.post(f"{URL}/{forest['id']}/recordings", json=body, headers=curator.headers)
    made: dict[str, Any] = answer.json()["recording"]
    files = {
        "cameras.jpg": ("image/jpeg", b"\xff\xd8strip"),
        "quality.html": ("text/html", PAGE),
        "quality.json": ("application/json", b'{"score": 87}'),
    }
    drawn(platform, PreviewSubject(forest["id"], made["id"]), files)
    return made


def test_a_recording_lists_its_previews_and_serves_them(
    api: httpx.Client, curator: Person, forest: dict[str, Any], recording: dict[str, Any]
) -> None:
    path = f"{URL}/{forest['id']}/recordings/{recording['id']}"
    shown = api.get(path, headers=curator.headers).json()["previews"]
    assert [one["name"] for one in shown] == ["cameras.jpg", "quality.html", "quality.json"]
    for one in shown:
        answer = api.get(f"{path}/previews/{one['name']}", headers=curator.headers)
        assert (answer.status_code, len(answer.content)) == (200, one["size_bytes"])
        assert answer.headers["etag"] == f'"{one["sha256"]}"'
        assert answer.headers["content-type"].partition(";")[0] == one["media_type"]
        again = api.get(
            f"{path}/previews/{one['name']}", headers=curator.headers | {"If-None-Match": answer.headers["etag"]}
        )
        assert again.status_code == 304
    assert api.get(f"{path}/previews/track.png", headers=curator.headers).json()["code"] == "not_found"


def test_a_page_is_shown_with_its_style_and_runs_and_loads_nothing(
    api: httpx.Client, curator: Person, forest: dict[str, Any], recording: dict[str, Any]
) -> None:
    path = f"{URL}/{forest['id']}/recordings/{recording['id']}/previews/quality.html"
    answer = api.get(path, headers=curator.headers)
    assert answer.content == PAGE
    assert answer.headers["content-disposition"].startswith("inline")
    policy = [part.strip() for part in answer.headers["content-security-policy"].split(";")]
    assert policy == ["default-src 'none'", "style-src 'unsafe-inline'", "img-src data:", "sandbox"]
    assert answer.headers["x-content-type-options"] == "nosniff"


def test_a_name_that_no_preview_has_is_refused(
    api: httpx.Client, curator: Person, forest: dict[str, Any], recording: dict[str, Any]
) -> None:
    for name in ["..%2fsecret.png", "cameras.svg", "labels.npz", ".png", "a" * 200 + ".png"]:
        path = f"{URL}/{forest['id']}/recordings/{recording['id']}/previews/{name}"
        assert api.get(path, headers=curator.headers).status_code in (404, 422)


def test_overlays_are_those_of_the_run_whose_labels_count(
    api: httpx.Client, platform: Platform, curator: Person, forest: dict[str, Any]
) -> None:
    def overlay() -> bytes:
        return api.get(f"{URL}/{forest['id']}/previews/overlay_CAM_FRONT.jpg", headers=curator.headers).content

    def draw(recipe: str, content: bytes) -> None:
        drawn(platform, PreviewSubject(forest["id"], recipe=recipe), {"overlay_CAM_FRONT.jpg": ("image/jpeg", content)})

    draw("a" * 64, b"of the first run")
    assert overlay() == b"of the first run"
    draw("b" * 64, b"of the second run")
    assert overlay() == b"of the second run"
    made = labels(platform, forest)
    with platform.database.transaction() as session:
        session.get_one(LabelSet, made.id).recipe = "a" * 64
    assert overlay() == b"of the first run"
    shown = api.get(f"{URL}/{forest['id']}", headers=curator.headers).json()
    assert [one["name"] for one in shown["previews"]] == ["overlay_CAM_FRONT.jpg"]
    assert "bev.png" in [one["name"] for one in shown["artefacts"]]


def test_previews_drawn_again_take_the_place_of_the_old(platform: Platform) -> None:
    ada = person(platform, "curator")
    with platform.database.transaction() as session:
        row = SequenceRow(owner_id=ada.user_id, name="forest")
        session.add(row)
        session.flush()
        shown = PreviewSubject(row.id, recipe="c" * 64)
    for content in (b"old", b"new"):
        kept = drawn(platform, shown, {"overlay_CAM_BACK.jpg": ("image/jpeg", content)})
    assert len(kept) == 1
    with platform.database.reading() as session:
        found = session.connection().exec_driver_sql("SELECT blob_sha256, size_bytes FROM previews").all()
    assert found == [(kept[0].blob.sha256, 3)]


V1 = "/api/v1"
STORED = png_of(np.full((4, 4), of_class(1), np.uint8))


def jpeg() -> bytes:
    content = io.BytesIO()
    Image.new("RGB", (64, 40), (38, 166, 91)).save(content, "JPEG")
    return content.getvalue()


@pytest.fixture
def pictures(api: httpx.Client, platform: Platform, curator: Person) -> Mapping[str, str]:
    """The addresses of one picture of each kind, all with traversable ground in them."""
    grid = np.zeros((256, 256, 32), np.uint8)
    grid[64:192, 64:192, 9] = 1
    sequence = laid.sequence(api, curator)
    a, b = (laid.labels(platform, sequence, contents=[labels_npz(grid)], seed=seed) for seed in (b"a", b"b"))
    token = next(iter(b.frames))
    compared = laid.label_comparison(platform, sequence["id"], (a.id, b.id))
    with platform.database.transaction() as session:
        session.query(Artefact).filter_by(label_set_id=b.id, name="bev.png").delete()
        laid._artefact(session, platform, b.id, "bev.png", STORED)
        laid._artefact(session, platform, b.id, "thumbnail.jpg", jpeg())
        row = session.get_one(LabelSet, b.id)
        row.t_voxels, row.p_voxels, row.n_voxels = 700, 200, 100
    return {
        "frame": f"{V1}/frames/{token}/bev.png",
        "stored": f"{V1}/sequences/{sequence['id']}/previews/bev.png",
        "difference": f"{V1}/sequences/{sequence['id']}/label-comparisons/{compared}/frames/{token}.png",
        "figure": f"{V1}/statistics/composition.png",
        "earlier": f"{V1}/sequences/{sequence['id']}/previews/thumbnail.jpg",
    }


def shows(png: bytes, colours: ColourName) -> bool:
    """Whether the picture has a pixel of class T in this palette."""
    pixels = np.asarray(Image.open(io.BytesIO(png)).convert("RGBA"))[..., :3]
    return bool((pixels == np.array(PALETTES[colours][1])).all(axis=-1).any())


@pytest.mark.whole
def test_a_picture_has_the_default_colours_or_the_paper_s(
    api: httpx.Client, curator: Person, pictures: Mapping[str, str]
) -> None:
    for kind in ["frame", "stored", "difference", "figure"]:

        def asked(path: str = pictures[kind], **more: Any) -> httpx.Response:
            return api.get(path, headers=curator.headers | more.pop("headers", {}), **more)

        plain, paper = asked(), asked(params={"colours": "paper"})
        assert asked(params={"colours": "default"}).content == plain.content
        assert (shows(plain.content, "default"), shows(plain.content, "paper")) == (True, False)
        assert (shows(paper.content, "default"), shows(paper.content, "paper")) == (False, True)
        assert plain.headers["etag"] != paper.headers["etag"]
        for tag, status in ((paper.headers["etag"], 304), (plain.headers["etag"], 200)):
            again = asked(params={"colours": "paper"}, headers={"If-None-Match": tag})
            assert again.status_code == status
        refused = asked(params={"colours": "pink"})
        assert (refused.status_code, refused.json()["code"]) == (422, "invalid_request")


def test_a_picture_of_an_earlier_label_set_is_served_as_it_is_stored(
    api: httpx.Client, curator: Person, pictures: Mapping[str, str]
) -> None:
    plain = api.get(pictures["earlier"], headers=curator.headers)
    answer = api.get(pictures["earlier"], params={"colours": "paper"}, headers=curator.headers)
    assert (answer.status_code, answer.content) == (200, jpeg())
    assert answer.headers["content-type"] == plain.headers["content-type"]
