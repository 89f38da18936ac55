"""A dataset is imported by `stone serve`, whose worker and then whose whole platform is killed meanwhile.

Catches alone what the real processes of one machine do to each other: an upload that the labeler does not find, a run
that is not taken up after a power cut, files of the run that are another's.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import httpx
import pytest

from stone_client.server.dataset_imports import DatasetWishes, read_import, send_dataset
from stone_client.server.sequences import Item
from testing.stone_serve import Serving, serving, until
from testing.worlds.published_datasets import SyntheticDataset, made_labels, write_published_tar

pytestmark = pytest.mark.whole

LABELS = tuple(made_labels(seed) for seed in range(2))
SCENES = SyntheticDataset(scenes=3, frames=2, labels=LABELS)
TERMINAL = ("succeeded", "failed", "cancelled")


def quiet(_stage: str, _done: int, _total: int) -> None:
    """Tests watch nothing."""


def shown(up: Serving, import_id: str) -> Item:
    with up.api() as api:
        return read_import(api, import_id)


def states(one: Mapping[str, Any]) -> list[str]:
    return [scene["state"] for scene in one["scenes"]]


def test_a_dataset_is_imported_though_worker_and_platform_are_killed(tmp_path: Path) -> None:
    tar, data = write_published_tar(tmp_path / "field.tar", SCENES), tmp_path / "the data"
    with serving(data) as up:
        with up.api() as api:
            import_id = send_dataset(api, tar, DatasetWishes("field"), quiet)["id"]
        until(lambda: "running" in states(shown(up, import_id)))
        up.child("worker").kill()
        until(lambda: "succeeded" in states(shown(up, import_id)))
        up.kill_9()
    with serving(data) as up:
        until(lambda: shown(up, import_id)["state"] in TERMINAL)
        made = shown(up, import_id)
        assert (made["state"], made["failure"], made["scenes_done"]) == ("succeeded", None, 3)
        with up.api() as api:
            sequences = {one["id"]: one for one in api.pages("/sequences")}
        assert [sequences[scene["sequence_id"]]["name"] for scene in made["scenes"]] == list(SCENES.names)
        for scene in range(SCENES.scenes):
            for frame, token in enumerate(SCENES.tokens(scene)):
                assert labels_of(up, token) == LABELS[frame]


def labels_of(up: Serving, token: str) -> bytes:
    address = f"{up.url}/api/v1/frames/{token}/labels.npz"
    return httpx.get(address, headers={"Authorization": f"Bearer {up.token}"}).raise_for_status().content
