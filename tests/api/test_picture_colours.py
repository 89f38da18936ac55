"""Pictures of labels in the colours that were asked for; what has no palette of ours is served as it is stored."""

import io
from collections.abc import Mapping
from typing import Any

import httpx
import numpy as np
import pytest
from PIL import Image

from services.domain.viewer.indexed_pictures import of_class, png_of
from services.runtime.orm import Artefact, LabelSet
from services.runtime.platform import Platform
from stone.labels.class_colours import PALETTES, ColourName
from testing.api.serving import Person
from testing.worlds import made
from testing.worlds.benchmark_world import labels_npz

URL = "/api/v1"
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
    sequence = made.sequence(api, curator)
    a, b = (made.labels(platform, sequence, contents=[labels_npz(grid)], seed=seed) for seed in (b"a", b"b"))
    token = next(iter(b.frames))
    compared = made.label_comparison(platform, sequence["id"], (a.id, b.id))
    with platform.database.transaction() as session:
        session.query(Artefact).filter_by(label_set_id=b.id, name="bev.png").delete()
        made._artefact(session, platform, b.id, "bev.png", STORED)
        made._artefact(session, platform, b.id, "thumbnail.jpg", jpeg())
        row = session.get_one(LabelSet, b.id)
        row.t_voxels, row.p_voxels, row.n_voxels = 700, 200, 100
    return {
        "frame": f"{URL}/frames/{token}/bev.png",
        "stored": f"{URL}/sequences/{sequence['id']}/previews/bev.png",
        "difference": f"{URL}/sequences/{sequence['id']}/label-comparisons/{compared}/frames/{token}.png",
        "figure": f"{URL}/statistics/composition.png",
        "earlier": f"{URL}/sequences/{sequence['id']}/previews/thumbnail.jpg",
    }


def shows(png: bytes, colours: ColourName) -> bool:
    """Whether the picture has a pixel of class T in this palette."""
    pixels = np.asarray(Image.open(io.BytesIO(png)).convert("RGBA"))[..., :3]
    return bool((pixels == np.array(PALETTES[colours][1])).all(axis=-1).any())


@pytest.mark.parametrize("kind", ["frame", "stored", "difference", "figure"])
def test_a_picture_has_the_default_colours_or_the_paper_s(
    api: httpx.Client, curator: Person, pictures: Mapping[str, str], kind: str
) -> None:
    def asked(**more: Any) -> httpx.Response:
        return api.get(pictures[kind], headers=curator.headers | more.pop("headers", {}), **more)

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
