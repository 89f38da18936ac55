"""`stone dataset`: splits, statistics and versions against the real API on a real socket."""

import hashlib
import io
import json
import tarfile
from pathlib import Path
from typing import Any

import pytest
from PIL import Image
from typer.testing import Result

from services.domain.datasets.queries import dataset_named
from services.runtime.platform import Platform
from testing.api.serving import Person, person
from testing.worlds.published import published_sequence
from tests.api.inputs_made import made_version_input
from tests.stone_client.participating import answered, refused, stone


@pytest.fixture
def owner(platform: Platform) -> Person:
    return person(platform, "curator")


@pytest.fixture
def names(platform: Platform, owner: Person) -> list[str]:
    """Of three sequences on three lakes, one of them by night."""
    said = [("day", "A"), ("dusk", "B"), ("night", "C")]
    for illumination, region in said:
        published_sequence(platform, owner.user_id, environment="lake", illumination=illumination, region=region)
    from services.domain.datasets.catalogue import labelled_sequences

    with platform.database.reading() as session:
        found = {one.entry.illumination: one.entry.name for one in labelled_sequences(session)}
    return [found[illumination] for illumination, _ in said]


@pytest.fixture(autouse=True)
def as_administrator(platform: Platform, url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STONE_URL", url)
    monkeypatch.setenv("STONE_TOKEN", person(platform, "administrator").secret)


def put(tmp_path: Path, **parts: Any) -> Result:
    path = tmp_path / "splits.json"
    path.write_text(json.dumps(parts))
    return stone("dataset", "splits", "put", path, "--reason", "test", "--yes")


def test_a_proposal_is_printed_and_put_as_it_was_printed(tmp_path: Path, names: list[str]) -> None:
    printed = stone("dataset", "splits", "propose", "1,1,1", "--json")
    assert printed.exit_code == 0
    path = tmp_path / "splits.json"
    path.write_text(printed.stdout)
    shown = stone("dataset", "splits", "put", path, "--yes")
    assert shown.exit_code == 0, shown.stderr
    assert "train: 1" in shown.stdout
    record = answered("dataset", "splits", "show")
    assert record["revision"] == 1
    assert sorted(one["name"] for part in ("train", "val", "test") for one in record[part]) == sorted(names)


def test_splits_are_put_by_name_and_a_rule_that_is_broken_is_said(tmp_path: Path, names: list[str]) -> None:
    assert put(tmp_path, train=names[:1], val=[], test=names[2:]).exit_code == 0
    broken = put(tmp_path, train=names[:2], val=names[:1], test=[])
    assert refused(broken) == "split_refused"
    assert "listed more than once" in broken.stderr


def test_a_file_of_an_older_revision_is_refused(tmp_path: Path, names: list[str]) -> None:
    assert put(tmp_path, train=names, val=[], test=[], revision=0).exit_code == 0
    assert refused(put(tmp_path, train=[], val=[], test=[], revision=0)) == "precondition_failed"


def test_a_file_without_splits_is_refused(tmp_path: Path) -> None:
    for text, code in [
        ("nothing", "bad_splits_file"),
        ("[" * 100_000, "bad_splits_file"),
        ('{"train": []}', "bad_splits_file"),
        ('{"train": [7], "val": [], "test": []}', "bad_splits_file"),
        ('{"train": ["unheard"], "val": [], "test": []}', "not_found"),
    ]:
        path = tmp_path / "splits.json"
        path.write_text(text)
        assert refused(stone("dataset", "splits", "put", path, "--yes")) == code


def test_a_name_that_two_owners_gave_is_not_guessed(tmp_path: Path, platform: Platform, owner: Person) -> None:
    ids = [published_sequence(platform, person(platform, "curator").user_id, region=region) for region in "ab"]
    from services.runtime.orm import SequenceRow

    with platform.database.transaction() as session:
        for one in ids:
            session.get_one(SequenceRow, one).name = "lake"
    assert refused(put(tmp_path, train=["lake"], val=[], test=[])) == "ambiguous_name"
    assert put(tmp_path, train=ids[:1], val=[], test=[]).exit_code == 0


def test_statistics_are_shown_and_drawn(tmp_path: Path, names: list[str]) -> None:
    result = stone("dataset", "statistics", "--figure", tmp_path / "composition.png")
    assert result.exit_code == 0, result.stderr
    for word in ("lake", "dusk", "night", "by region", "all"):
        assert word in result.stdout
    with Image.open(tmp_path / "composition.png") as picture:
        assert picture.format == "PNG"
    assert answered("dataset", "statistics")["total"]["sequences"] == 3
    assert refused(stone("dataset", "statistics", "--dataset", "nothing")) == "not_found"


def test_a_version_is_published_and_downloaded_by_a_participant(
    tmp_path: Path, platform: Platform, names: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert put(tmp_path, train=names[:1], val=names[1:2], test=names[2:]).exit_code == 0
    made = answered("dataset", "publish", "stone-1.0", "--licence", "CC0", "--yes")
    assert made["sizes"] == {"train": 1, "val": 1, "test": 1}
    monkeypatch.setenv("STONE_TOKEN", person(platform, "participant").secret)
    assert "stone-1.0" in stone("dataset", "list").stdout
    folder = tmp_path / "dataset"
    files = answered("dataset", "download", "stone-1.0", "--output", folder)["files"]
    called = ["stone-1.0-train.tar", "stone-1.0-val.tar", "stone-1.0.manifest.json"]
    assert sorted(path.name for path in folder.iterdir()) == called
    for file in files:
        assert hashlib.sha256(Path(file["output"]).read_bytes()).hexdigest() == file["sha256"]
    with tarfile.open(folder / called[0]) as tar:
        sums = io.TextIOWrapper(tar.extractfile("sha256sum.txt")).read().splitlines()  # type: ignore[type-var]
        for line in sums:
            digest, _, name = line.partition("  ")
            assert hashlib.sha256(tar.extractfile(name).read()).hexdigest() == digest  # type: ignore[union-attr]
    again = answered("dataset", "download", "stone-1.0", "--output", folder)["files"]
    assert [file["resumed_at_bytes"] for file in again] == [file["size_bytes"] for file in again]


def test_inputs_of_a_version_are_downloaded_beside_its_labels(
    tmp_path: Path, platform: Platform, names: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert put(tmp_path, train=names[:1], val=names[1:2], test=names[2:]).exit_code == 0
    assert stone("dataset", "publish", "stone-1.0", "--yes").exit_code == 0
    with platform.database.reading() as session:
        version = dataset_named(session, "stone-1.0")
        assert version is not None
    for name in (names[0], names[2]):
        made_version_input(platform, version.id, name, {"samples/LIDAR_TOP/sweep.pcd.bin": bytes(200_000)})
    monkeypatch.setenv("STONE_TOKEN", person(platform, "participant").secret)
    folder = tmp_path / "dataset"
    found = {
        one["name"]: one
        for one in answered("dataset", "download", "stone-1.0", "--output", folder, "--inputs")["inputs"]
    }
    assert {name: one["state"] for name, one in found.items()} == {names[0]: "ready", names[1]: "lost"}
    (output,) = (folder / "inputs").rglob("*.tar")
    assert output == folder / "inputs" / "train" / f"{names[0]}.tar"
    content = output.read_bytes()
    assert hashlib.sha256(content).hexdigest() == found[names[0]]["sha256"]
    said = stone("dataset", "download", "stone-1.0", "--output", folder, "--inputs")
    assert (str(output) in said.stdout, names[1] in said.stderr) == (True, True)
