"""Previews are served to those who may see what they show, as files that a browser may show and never run."""

from pathlib import Path
from typing import Any

import httpx
import pytest

from services.domain.sequences.previews import PreparedPreview, PreviewSubject, prepared_previews, replace_previews
from services.runtime.orm import LabelSet, SequenceRow, new_id
from services.runtime.platform import Platform
from services.runtime.store import blobs
from testing.api.serving import Person, person
from testing.worlds.made import labels, sequence, upload

URL = "/api/v1/sequences"
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
def forest(api: httpx.Client, curator: Person) -> dict[str, Any]:
    return sequence(api, curator)


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


def test_previews_of_others_do_not_exist(
    api: httpx.Client, platform: Platform, forest: dict[str, Any], recording: dict[str, Any]
) -> None:
    other = person(platform, "curator")
    own = sequence(api, other, "mine")
    for sequence_id in (forest["id"], own["id"]):
        path = f"{URL}/{sequence_id}/recordings/{recording['id']}/previews/cameras.jpg"
        assert api.get(path, headers=other.headers).status_code == 404
    assert api.get(f"{URL}/{forest['id']}/previews/overlay_CAM_FRONT.jpg", headers=other.headers).status_code == 404


@pytest.mark.parametrize("name", ["..%2fsecret.png", "cameras.svg", "labels.npz", ".png", "a" * 200 + ".png"])
def test_a_name_that_no_preview_has_is_refused(
    api: httpx.Client, curator: Person, forest: dict[str, Any], recording: dict[str, Any], name: str
) -> None:
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


def test_previews_drawn_again_take_the_place_of_the_old(platform_on: Platform) -> None:
    ada = person(platform_on, "curator")
    with platform_on.database.transaction() as session:
        row = SequenceRow(owner_id=ada.user_id, name="forest")
        session.add(row)
        session.flush()
        shown = PreviewSubject(row.id, recipe="c" * 64)
    for content in (b"old", b"new"):
        kept = drawn(platform_on, shown, {"overlay_CAM_BACK.jpg": ("image/jpeg", content)})
    assert len(kept) == 1
    with platform_on.database.reading() as session:
        found = session.connection().exec_driver_sql("SELECT blob_sha256, size_bytes FROM previews").all()
    assert found == [(kept[0].blob.sha256, 3)]
