"""Versions of the dataset: published once, downloadable whole or by ranges, and of test's labels nothing anywhere."""

import hashlib
import io
import tarfile
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import httpx
import pytest
from sqlalchemy import delete, select, text, update
from sqlalchemy.exc import DatabaseError

from services.domain.datasets.catalogue import labelled_sequences
from services.runtime.orm import (
    Artefact,
    Blob,
    Dataset,
    DatasetMember,
    DatasetPart,
    LabelledFrameRow,
    LabelSet,
    SequenceRow,
)
from services.runtime.platform import Platform
from services.runtime.settings import PublishingSettings, Settings, StoreSettings
from services.runtime.store.blobs import collect_garbage
from services.runtime.store.factory import open_store
from testing.api.serving import Person, person, serving
from testing.worlds.made import labels
from testing.worlds.published import published_sequence
from web.main import make_site

URL = "/api/v1/datasets"


@dataclass(frozen=True)
class Release:
    """A version made through the API of one sequence a part, by the ids of the sequences."""

    name: str
    shown: Mapping[str, Any]
    ids: Mapping[str, str]
    owner: Person
    administrator: Person
    reader: Person

    @property
    def path(self) -> str:
        return f"{URL}/{self.name}"


@pytest.fixture
def release(api: httpx.Client, platform: Platform) -> Release:
    return released(api, platform)


@pytest.fixture
def release_on(api_on: httpx.Client, platform_on: Platform) -> Release:
    return released(api_on, platform_on)


def released(api: httpx.Client, platform: Platform) -> Release:
    owner, administrator = person(platform, "curator"), person(platform, "administrator")
    said = {"environment": "lake", "illumination": "dusk"}
    parts = ("train", "val", "test")
    ids = {part: published_sequence(platform, owner.user_id, region=f"of-{part}", **said) for part in parts}
    body = {part: [one] for part, one in ids.items()} | {"reason": "why"}
    put = api.put("/api/v1/splits", json=body, headers={**administrator.headers, "If-Match": "*"})
    assert put.status_code == 200, put.text
    made = publish(api, administrator, "stone-1.0", licence="CC-BY-4.0")
    assert made.status_code == 201, made.text
    return Release("stone-1.0", made.json(), ids, owner, administrator, person(platform, "participant"))


def publish(api: httpx.Client, who: Person, name: str, **more: str) -> httpx.Response:
    return api.post(URL, json={"name": name, "reason": "release", **more}, headers=who.headers)


def manifest_of(api: httpx.Client, release: Release) -> dict[str, Any]:
    answer = api.get(f"{release.path}/manifest", headers=release.reader.headers)
    assert answer.status_code == 200
    assert hashlib.sha256(answer.content).hexdigest() == release.shown["manifest_sha256"]
    manifest: dict[str, Any] = answer.json()
    return manifest


def contents_of(platform: Platform, sequence_id: str) -> dict[str, bytes]:
    """What a sequence's labels are, by the names a version gives them; read as the routes of the owner do.

    What only the viewer reads is not among them.
    """
    found = {}
    with platform.database.reading() as session:
        name = session.get_one(SequenceRow, sequence_id).name
        labels_id = select(LabelSet.id).where(LabelSet.sequence_id == sequence_id).scalar_subquery()
        files = select(Artefact, Blob).join(Blob, Blob.sha256 == Artefact.blob_sha256)
        packs = {}
        for artefact, blob in session.execute(files.where(Artefact.label_set_id == labels_id)):
            content = b"".join(platform.store.read(blob.object_key))
            packs[artefact.id] = content
            if not artefact.name.startswith(("labels/", "scene/")):
                found[f"sequences/{name}/{artefact.name}"] = content
        for frame in session.scalars(select(LabelledFrameRow).where(LabelledFrameRow.label_set_id == labels_id)):
            stop = frame.offset_bytes + frame.length_bytes
            found[f"gts/{name}/{frame.token}/labels.npz"] = packs[frame.pack_id][frame.offset_bytes : stop]
    return found


def test_the_manifest_says_what_the_version_is_made_of(api: httpx.Client, platform: Platform, release: Release) -> None:
    manifest = manifest_of(api, release)
    with platform.database.reading() as session:
        entries = {one.entry.id: one for one in labelled_sequences(session)}
    names = {part: entries[one].entry.name for part, one in release.ids.items()}
    assert (manifest["stone_dataset"], manifest["version"], manifest["licence"]) == (1, "stone-1.0", "CC-BY-4.0")
    assert manifest["splits"] == {part: [name] for part, name in names.items()}
    assert [one["split"] for one in manifest["sequences"]] == ["train", "val", "test"]
    train = manifest["sequences"][0]
    assert train["label_set"]["recipe"] == entries[release.ids["train"]].labels.recipe
    assert (train["frames"], train["duration_s"], train["distance_m"]) == (3, 25.0, 30.5)
    assert manifest["statistics"]["total"]["sequences"] == 3
    for part in ("train", "val"):
        expected = contents_of(platform, release.ids[part])
        listed = {file["name"]: (file["size_bytes"], file["sha256"]) for file in manifest["files"][part]}
        sums = listed.pop("sha256sum.txt")
        assert listed == {name: (len(c), hashlib.sha256(c).hexdigest()) for name, c in expected.items()}
        assert sums[0] > 0


def test_a_part_is_a_tar_of_what_the_manifest_lists(api: httpx.Client, platform: Platform, release: Release) -> None:
    answer = api.get(f"{release.path}/archives/train", headers=release.reader.headers)
    assert answer.status_code == 200
    assert answer.headers["content-type"] == "application/x-tar"
    (shown,) = (part for part in release.shown["parts"] if part["part"] == "train")
    assert (len(answer.content), hashlib.sha256(answer.content).hexdigest()) == (
        shown["tar_bytes"], shown["tar_sha256"]
    )  # fmt: skip
    with tarfile.open(fileobj=io.BytesIO(answer.content)) as tar:
        found = {member.name: tar.extractfile(member).read() for member in tar}  # type: ignore[union-attr]
    sums = found.pop("sha256sum.txt").decode()
    assert found == contents_of(platform, release.ids["train"])
    assert sums == "".join(f"{hashlib.sha256(c).hexdigest()}  {name}\n" for name, c in found.items())


def test_of_tests_labels_nothing_is_told_to_anybody(api: httpx.Client, platform: Platform, release: Release) -> None:
    """Of every answer about versions, to a participant and to an administrator: no content, digest, token or count."""
    hidden = contents_of(platform, release.ids["test"])
    with platform.database.reading() as session:
        row = session.scalars(select(LabelSet).where(LabelSet.sequence_id == release.ids["test"])).one()
        tokens = list(session.scalars(select(LabelledFrameRow.token).where(LabelledFrameRow.label_set_id == row.id)))
        blobs_of_it = select(Artefact.blob_sha256).where(Artefact.label_set_id == row.id)
        blobs = list(session.scalars(blobs_of_it.where(Artefact.name != "grid.json")))
        index = session.get_one(DatasetPart, (session.scalars(select(Dataset.id)).one(), "test"))
    hidden = {name: content for name, content in hidden.items() if not name.endswith("grid.json")}  # a public fact
    secrets = [hashlib.sha256(content).hexdigest() for content in hidden.values()]
    secrets += [*tokens, *blobs, row.id, row.recipe, index.index_sha256]
    paths = ["", f"/{release.name}", f"/{release.name}/manifest"]
    paths += [f"/{release.name}/archives/{part}" for part in ("train", "val", "test")]
    figure = f"/api/v1/statistics/composition.png?dataset={release.name}"
    for reader in (release.reader, release.administrator, release.owner):
        drawn = [figure] if reader is release.reader else []
        for path in [*(URL + path for path in paths), f"/api/v1/statistics?dataset={release.name}", *drawn]:
            answer = api.get(path, headers=reader.headers)
            told = answer.content + repr(sorted(answer.headers.items())).encode()
            assert [one for one in secrets if one.encode() in told] == [], path
            assert [name for name, content in hidden.items() if content in told] == [], path
    manifest = manifest_of(api, release)
    assert set(manifest["files"]) == {"train", "val"}
    test = manifest["sequences"][2]
    assert set(test) == {
        "name", "split", "environment", "illumination", "daylight", "region", "drive",
        "frames", "duration_s", "distance_m",
    }  # fmt: skip
    assert manifest["statistics"]["total"]["voxels"]["traversable"] == 200, "train and val have 100 each, test as many"


def test_a_version_says_how_well_its_labels_hold_but_not_those_of_test(api: httpx.Client, release: Release) -> None:
    known = {"held_out_recall": 0.9731, "held_out_m": 75.4, "gravest": {"code": "LAB-605", "harm": "wrong"}}
    shown = {one["split"]: {key: one[key] for key in known} for one in release.shown["sequences"]}
    assert shown == {"train": known, "val": known, "test": dict.fromkeys(known)}
    total = api.get(f"/api/v1/statistics?dataset={release.name}", headers=release.reader.headers).json()["total"]
    assert (total["held_out_recall"], total["held_out_m"], total["held_out_known"]) == (0.9731, 150.8, 2)
    described = manifest_of(api, release)["sequences"]
    assert [one.get("label_set", {}).get("quality") for one in described] == [known, known, None]


@pytest.mark.parametrize(("recall", "told"), [(0.8996, "89.96%"), (None, "no held-out recall")])
def test_a_version_is_refused_if_labels_are_below_the_administrators_limit_or_unknown(
    platform: Platform, recall: float | None, told: str
) -> None:
    limit = PublishingSettings(least_held_out_recall=0.9)
    strict = Platform(platform.settings.model_copy(update={"publishing": limit}), platform.database, platform.store)
    with serving(strict, make_site(strict)) as url, httpx.Client(base_url=url) as api:
        release = released(api, strict)
        with platform.database.transaction() as session:
            of_test = LabelSet.sequence_id == release.ids["test"]
            session.execute(update(LabelSet).where(of_test).values(held_out_recall=recall))
            name = session.get_one(SequenceRow, release.ids["test"]).name
        answer = publish(api, release.administrator, "stone-2.0")
        page = api.get("/dataset/new", headers=release.administrator.headers).text
    assert (answer.status_code, answer.json()["code"]) == (409, "held_out_low")
    for said in (f"{name} has {told}", "90.00%", "STONE_PUBLISHING__LEAST_HELD_OUT_RECALL"):
        assert said in answer.json()["detail"]
    assert "Cannot be published yet" in page
    assert f"{name} has {told}" in page


def test_there_is_no_route_to_the_files_of_test(api: httpx.Client, release: Release) -> None:
    for part in ["test", "all", "TEST", "train%2F..%2Ftest"]:
        answer = api.get(f"{release.path}/archives/{part}", headers=release.administrator.headers)
        assert answer.status_code in (404, 422)


def test_a_version_stays_as_it_is_whatever_becomes_of_its_sequences(
    api: httpx.Client, platform: Platform, release: Release
) -> None:
    """Renamed words, labels made anew, sequences deleted, splits emptied, the store collected without mercy."""
    path = f"{release.path}/archives/train"
    before = [api.get(one, headers=release.reader.headers) for one in (release.path, path)]
    train, sequences = release.ids["train"], "/api/v1/sequences"
    match = {**release.owner.headers, "If-Match": "*"}
    assert api.patch(f"{sequences}/{train}", json={"illumination": "night"}, headers=match).status_code == 200
    with platform.database.reading() as session:
        facts = {"id": train, "name": session.get_one(SequenceRow, train).name, "owner_id": release.owner.user_id}
    labels(platform, facts, seed=b"anew")
    for one in release.ids.values():
        assert api.delete(f"{sequences}/{one}", headers=match).status_code == 204
    hasty = Settings(
        data_folder=platform.settings.data_folder, database=platform.settings.database, store=StoreSettings(grace_s=0.0)
    )
    gone = collect_garbage(Platform(hasty, platform.database, open_store(hasty)))
    assert gone.rows > 0, "the labels made anew went"
    after = [api.get(one, headers=release.reader.headers) for one in (release.path, path)]
    assert [answer.content for answer in after] == [answer.content for answer in before]
    manifest_of(api, release)
    with platform.database.reading() as session:
        held = session.scalars(select(DatasetMember.part).order_by(DatasetMember.part)).all()
        assert list(held) == ["test", "train", "val"]


def test_the_database_refuses_to_change_a_version(platform_on: Platform, release_on: Release) -> None:
    for table in ["datasets", "dataset_members", "dataset_parts", "dataset_packs"]:
        column = {"datasets": "licence", "dataset_members": "region", "dataset_parts": "files"}.get(table, "ordinal")
        with pytest.raises(DatabaseError, match="does not change"):  # noqa: SIM117
            with platform_on.database.transaction() as session:
                session.execute(text(f"UPDATE {table} SET {column} = {column}"))


def test_what_a_version_names_cannot_be_deleted_while_it_stands(platform_on: Platform, release_on: Release) -> None:
    with platform_on.database.reading() as session:
        of_version = Artefact.name.not_like("scene/%") & (Artefact.name != "thumbnail.png")
        held = session.scalars(select(Artefact.blob_sha256).where(of_version)).all()
    with platform_on.database.transaction() as session:
        session.execute(delete(LabelSet))
    assert len(held) == 21
    for sha256 in held:
        with pytest.raises(DatabaseError, match=r"(?i)foreign key"):  # noqa: SIM117
            with platform_on.database.transaction() as session:
                session.execute(delete(Blob).where(Blob.sha256 == sha256))


def test_nothing_can_be_published_without_splits_that_keep_the_rules(
    api: httpx.Client, platform: Platform, release: Release
) -> None:
    gone = release.ids["val"]
    api.delete(f"/api/v1/sequences/{gone}", headers={**release.owner.headers, "If-Match": "*"})
    broken = publish(api, release.administrator, "stone-2.0")
    assert (broken.status_code, broken.json()["code"]) == (409, "splits_broken")
    assert gone in broken.json()["detail"]
    body = {"train": [], "val": [], "test": [], "reason": "anew"}
    api.put("/api/v1/splits", json=body, headers={**release.administrator.headers, "If-Match": "*"})
    assert publish(api, release.administrator, "stone-2.0").json()["code"] == "no_splits"


def test_publishing_is_in_the_audit_log(api: httpx.Client, release: Release) -> None:
    log = api.get("/api/v1/admin/audit-log", headers=release.administrator.headers).json()["items"]
    (line,) = (line for line in log if line["act"] == "dataset.create")
    warned = ["day_and_night", "every_environment"]
    digest = release.shown["manifest_sha256"]
    assert line["facts"] == {"name": "stone-1.0", "manifest_sha256": digest, "warnings": warned}
    assert line["reason"] == "release"
