"""`stone dataset import` against a real server and its workers: a dataset in, its labels out, and faults by code."""

import json
import os
import shutil
import tarfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
from typer.testing import Result

from services.ingest import queue_handlers as ingest
from services.labeler import queue_handlers as labeler
from services.runtime.platform import Platform
from stone_client.errors import JobFailedError
from stone_client.sdk import Stone
from testing.api.serving import Person, client_of, person, serving
from testing.servers.fixtures import having
from testing.worlds.published_datasets import SyntheticDataset, made_labels, write_published, write_published_tar
from testing.worlds.released_datasets import ReleasedDataset, write_released_zip
from tests.stone_client.participating import refused, stone
from tests.stone_datasets.conftest import GOOD
from tests.stone_datasets.malformed import row
from tests.working import working

DATASET = SyntheticDataset(
    frames=2,
    cameras=("CAM_FRONT",),
    labels=(made_labels(1), made_labels(2)),
    splits={"train": ["field-0000"], "val": ["field-0001"]},
)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_published(tmp_path_factory.mktemp("published") / "offroad", DATASET)


pytestmark = pytest.mark.usefixtures("as_owner")


@pytest.fixture
def api(platform: Platform, owner: Person) -> Iterator[httpx.Client]:
    with client_of(platform) as client:
        client.headers.update(owner.headers)
        yield client


@contextmanager
def importing(platform: Platform) -> Iterator[None]:
    """Workers of the queues that import."""
    with working(platform, "ingest", ingest.handlers), working(platform, "labeler", labeler.handlers):
        yield


def imported(platform: Platform, *arguments: str | Path) -> dict[str, Any]:
    with importing(platform):
        result = stone("dataset", "import", *arguments, "--json")
    assert result.exit_code == 0, result.stderr
    said: dict[str, Any] = json.loads(result.stdout)
    return said


def uploads(api: httpx.Client) -> list[str]:
    return [one["state"] for one in api.get("/api/v1/uploads").json()["items"]]


@pytest.mark.whole
def test_a_folder_becomes_sequences_whose_labels_are_the_datasets_own(
    platform: Platform, api: httpx.Client, dataset: Path, tmp_path: Path
) -> None:
    """Catches alone labels that change on their way from a folder through upload, queues and store and out again.

    And a second import, of a tar with a class map, that overwrites the first or whose map is not applied.
    """
    made = imported(platform, dataset, "--public")
    assert (made["name"], made["state"], made["scenes_done"], made["frames"]) == ("offroad", "succeeded", 2, 4)
    listed = {one["name"]: one for one in api.get("/api/v1/sequences").json()["items"]}
    assert set(listed) == set(DATASET.names)
    assert [listed[scene["name"]]["id"] for scene in made["scenes"]] == [one["sequence_id"] for one in made["scenes"]]
    assert all(one["is_public"] and one["labels"]["frames"] == 2 for one in listed.values())
    for scene, name in enumerate(DATASET.names):
        for token in DATASET.tokens(scene):
            kept = api.get(f"/api/v1/frames/{token}/labels.npz").content
            assert kept == (dataset / "gts" / name / token / "labels.npz").read_bytes()
    again = imported(platform, dataset)
    assert (again["id"], uploads(api)) == (made["id"], ["consumed"]), "it is neither sent nor imported twice"
    assert stone("sequence", "download", "field-0000", "-o", tmp_path / "labels").exit_code == 0
    _exported_again(platform, dataset, tmp_path / "field.tar")
    _added_beside(platform, api, tmp_path)


def _exported_again(platform: Platform, dataset: Path, path: Path) -> None:
    """The nuScenes export has the samples and labels of the dataset, byte for byte."""
    with importing(platform):
        assert stone("sequence", "exports", "field-0000", "--format", "nuscenes").exit_code == 0
    assert stone("sequence", "download", "field-0000", "--format", "nuscenes", "-o", path).exit_code == 0
    with tarfile.open(path) as tar:
        held = {one.name.split("/", 1)[1] if "v1.0" in one.name.split("/")[0] else one.name: one for one in tar}
        found = {
            name: tar.extractfile(one).read()  # type: ignore[union-attr]
            for name, one in held.items()
            if name.startswith(("samples/", "gts/")) and one.isfile()
        }
    for name, content in found.items():
        assert (dataset / name).read_bytes() == content, name
    assert sum(name.startswith("gts/") for name in found) == 2
    assert sum(name.startswith("samples/") for name in found) == 2 * len(DATASET.sensors)


def _added_beside(platform: Platform, api: httpx.Client, tmp_path: Path) -> None:
    """A tar of the same sequences, with a class map: the second import overwrites nothing of the first."""
    tar = write_published_tar(tmp_path / "theirs.tar", DATASET, "theirs/")
    (tmp_path / "classes.yaml").write_text("name: swapped\nclasses: {0: free, 1: N, 2: P, 3: T, 255: unobserved}\n")
    asked = (tar, "--name", "theirs", "--classes", tmp_path / "classes.yaml")
    with importing(platform):
        assert refused(stone("dataset", "import", *asked)) == "sequences_exist"
    made = imported(platform, *asked, "--add-to-existing")
    assert (made["classes"], made["existing"]) == ("swapped", "add")
    sequence_id = made["scenes"][0]["sequence_id"]
    sets = api.get(f"/api/v1/sequences/{sequence_id}/label-sets").json()["items"]
    assert [one["frames"] for one in sets] == [2, 2]
    shown = stone("dataset", "import", "--list")
    assert shown.exit_code == 0
    assert "succeeded" in shown.stdout
    assert "failed" in shown.stdout


@pytest.mark.whole
def test_what_is_wrong_is_refused_by_its_code_with_table_and_row(
    platform: Platform, api: httpx.Client, tmp_path: Path
) -> None:
    folder, (code, place) = write_published(tmp_path / "wrong", GOOD), ("DST-018", "sample.json row 3")
    row("sample", 2, token=GOOD.tokens(0)[0])(folder)
    with importing(platform):
        result = stone("dataset", "import", folder)
    assert refused(result) == code
    assert place in result.stderr.replace("\n", "")
    (shown,) = api.get("/api/v1/dataset-imports").json()["items"]
    assert (shown["state"], shown["failure"]["code"]) == ("failed", code)
    assert place in shown["failure"]["sentence"]
    assert api.get("/api/v1/sequences").json()["items"] == [], "all of it, or nothing"


def test_a_dataset_that_the_layout_gives_away_costs_no_upload(api: httpx.Client, tmp_path: Path) -> None:
    (tmp_path / "photos").mkdir()
    assert refused(stone("dataset", "import", tmp_path / "photos")) == "DST-001"
    assert uploads(api) == []


def test_a_class_map_that_is_none_is_told_by_the_server_and_the_upload_stays(
    api: httpx.Client, dataset: Path, tmp_path: Path
) -> None:
    (tmp_path / "classes.yaml").write_text("name: theirs\nclasses: {0: grass}\n")
    assert refused(stone("dataset", "import", dataset, "--classes", tmp_path / "classes.yaml")) == "DST-070"
    assert uploads(api) == ["complete"]
    result: Result = stone("dataset", "import", dataset, "--no-wait")
    assert (result.exit_code, uploads(api)) == (0, ["consumed"])
    assert "Next: stone sequence watch" in result.stderr


def test_only_ones_own_import_of_the_same_wishes_is_gone_on_with(
    platform: Platform, api: httpx.Client, dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    classes = tmp_path / "classes.yaml"
    classes.write_text("name: theirs\nclasses: {0: free, 1: T, 2: P, 3: N, 255: unobserved}\n")
    lines = ([], ["--add-to-existing"], ["--name", "other"], ["--classes", classes])
    begun = [
        json.loads(stone("dataset", "import", dataset, "--no-wait", "--json", *line).stdout)["id"] for line in lines
    ]
    assert len(set(begun)) == len(lines)
    assert [
        json.loads(stone("dataset", "import", dataset, "--no-wait", "--json", *line).stdout)["id"] for line in lines
    ] == begun
    monkeypatch.setenv("STONE_TOKEN", person(platform, "administrator").secret)
    assert json.loads(stone("dataset", "import", "--list", "--json").stdout) == {"imports": []}
    assert json.loads(stone("dataset", "import", dataset, "--no-wait", "--json").stdout)["id"] not in begun
    assert len(api.get("/api/v1/dataset-imports").json()["items"]) == len(lines)


def test_who_may_not_set_the_draft_splits_is_refused_before_anything_is_sent(
    platform: Platform, api: httpx.Client, dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = stone("dataset", "import", dataset, "--set-splits")
    assert (refused(result), uploads(api)) == ("splits_forbidden", [])
    assert "stone auth login" in result.stderr.replace("\n", " ")
    monkeypatch.setenv("STONE_TOKEN", person(platform, "administrator").secret)
    assert stone("dataset", "import", dataset, "--set-splits", "--no-wait").exit_code == 0


@pytest.mark.whole
def test_a_zip_in_place_is_imported_once_with_the_layout_that_is_stated_and_nothing_is_sent(
    platform: Platform, owner: Person, api: httpx.Client, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches alone a command that sends what lies in place, or does not pass on what is stated."""
    what = ReleasedDataset(scenes=1, frames=2)
    write_released_zip(tmp_path / "STONE.zip", what)
    monkeypatch.setenv("STONE_TOKEN", person(platform, "administrator").secret)
    placed = having(platform, in_place={"folders": f"nas={tmp_path}"})
    with serving(placed) as url, importing(placed):
        monkeypatch.setenv("STONE_URL", url)
        line = ("import", "nas:STONE.zip", "--in-place", "--layout", "release", "--grid", "release", "--set-splits")
        first, again = stone(*line, "--json"), stone(*line)
        other = stone(*line[:3], "--name", "other", "--layout", "occ3d", "--add-to-existing")
        refusals = [
            stone("dataset", "import", "nas:nothing.zip", "--in-place"),
            stone("dataset", "import", "disk:STONE.zip", "--in-place"),
            stone("dataset", "import", "nas:STONE", "--in-place"),
            stone("dataset", "import", "STONE.zip", "--in-place"),
        ]
        os.utime(tmp_path / "STONE.zip", ns=(0, 10**18))
        changed = stone(*line[:3], "--name", "changed", "--add-to-existing")
    assert (first.exit_code, again.exit_code) == (0, 0), first.stderr + again.stderr
    made = json.loads(first.stdout)
    facts = {"name": "STONE", "layout": "release", "grid": "release", "place": {"root": "nas", "path": "STONE.zip"}}
    assert {key: made[key] for key in facts} == facts
    assert (made["frames"], made["splits_refused"]) == (what.scenes * what.frames, ["no_splits"])
    assert made["id"] in again.stdout
    assert "has no split" in again.stdout
    assert "nas:STONE.zip as it was at" in again.stdout
    assert changed.exit_code == 0, "the way out that the command names"
    assert refused(other) == "DST-062", "labels of the release are not in the array of Occ3D's"
    codes = [refused(one) for one in refusals]
    assert codes == ["recording_vanished", "unknown_root", "no_archive", "bad_place"]
    assert uploads(api) == []


@pytest.mark.whole
def test_the_sdk_imports_and_raises_what_was_wrong(platform: Platform, dataset: Path, tmp_path: Path) -> None:
    """Catches alone an SDK that differs from the command."""
    wrong = Path(shutil.copytree(dataset, tmp_path / "wrong"))
    (wrong / "v1.0-trainval" / "log.json").unlink()
    with importing(platform), Stone() as there:
        with pytest.raises(JobFailedError, match=r"log\.json") as caught:
            there.import_dataset(wrong)
        assert caught.value.code == "DST-010"
        made = there.import_dataset(dataset, name="offroad")
    assert [scene["name"] for scene in made["scenes"]] == list(DATASET.names)
