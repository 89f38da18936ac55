"""The pages of a sequence whose labels were imported: each says so where it would speak of a recording."""

import re
from collections.abc import Iterator
from dataclasses import dataclass

import httpx
import pytest
from sqlalchemy import select

from services.runtime.access import sessions
from services.runtime.orm import SequenceRow, User
from services.runtime.platform import Platform
from testing.api.serving import Person, serving
from testing.worlds.brought_datasets import bring_dataset
from testing.worlds.published_datasets import SyntheticDataset, made_labels, write_published_tar
from testing.worlds.runs import run_all
from web.main import make_site

SCENE = SyntheticDataset(scenes=1, cameras=("CAM_FRONT",), labels=[made_labels()])
SECTIONS = {
    "": "imported",
    "/frames": SCENE.tokens(0)[0],
    "/track": "the axes are the published dataset's",
    "/recordings": "These labels were imported",
    "/calibration": "Imported labels have no overlay",
    "/processing": "These labels were imported",
    "/label-sets": "A second label set appears when",
    "/exports": "SemanticKITTI",
    "/view": "data-viewer",
}
WORDS_OF_RECORDINGS = "poses are odometry|No recording yet|Not processed yet"
OF_FRAME = ("labels.npz", "voxels", "bev.png")


@dataclass(frozen=True)
class Shown:
    """The site with an imported sequence, and its owner's requests to it."""

    http: httpx.Client
    sequence_id: str

    def page(self, section: str) -> str:
        answer = self.http.get(f"/sequences/{self.sequence_id}{section}")
        assert answer.status_code == 200, answer.text
        return answer.text


@pytest.fixture
def shown(platform: Platform, curator: Person, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shown]:
    tar = write_published_tar(tmp_path_factory.mktemp("published") / "field.tar", SCENE)
    bring_dataset(platform, tar, curator.user_id)
    run_all(platform)
    with platform.database.transaction() as session:
        sequence_id = session.scalars(select(SequenceRow.id)).one()
        cookie = sessions.open_session(session, session.get_one(User, curator.user_id), 3600.0).secret
    with serving(platform, make_site(platform)) as url:
        cookies = {"Cookie": f"stone_session={cookie}"}
        with httpx.Client(base_url=url, headers=cookies, timeout=300) as http:
            yield Shown(http, sequence_id)


def test_every_section_says_that_labels_were_imported_where_it_would_speak_of_a_recording(shown: Shown) -> None:
    for section, words in SECTIONS.items():
        assert words in re.sub(r"&#39;", "'", shown.page(section)), section
    for section in ("/track", "/recordings", "/processing"):
        assert not re.search(WORDS_OF_RECORDINGS, shown.page(section)), section


def test_scene_and_frames_are_shown_without_a_recording(shown: Shown) -> None:
    scene = shown.http.get(f"/api/v1/sequences/{shown.sequence_id}/scene")
    assert (scene.status_code, scene.json()["reference"]) == (200, None)
    token = SCENE.tokens(0)[1]
    for name in OF_FRAME:
        assert shown.http.get(f"/api/v1/frames/{token}/{name}").status_code == 200, name
