"""The released dataset goes its whole way on a platform at its own grid: ZIP, labels, version, phase, score, export."""

import io
import json
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from sqlalchemy import select

from services.domain.exports.requests import FORMATS, start_export
from services.domain.viewer.frame_grids import read_grids
from services.runtime.database.migrate import upgrade
from services.runtime.orm import Artefact, Blob, Dataset, Job, LabelSet, Phase, SequenceRow
from services.runtime.platform import Platform
from stone_base.label_grid import RELEASE, recorded_grid
from testing.api.serving import Person, person
from testing.servers.fixtures import make_settings, opened
from testing.worlds.benchmark_world import World, benchmark_over, run_eval, team_led_by
from testing.worlds.brought_datasets import bring_dataset, files_of
from testing.worlds.drives import exported_files
from testing.worlds.published import dataset
from testing.worlds.released_datasets import ReleasedDataset, write_released_zip
from testing.worlds.runs import run_all
from testing.worlds.sending import scores_of, send
from testing.worlds.submission_files import write_submission

pytestmark = pytest.mark.whole

WHAT = ReleasedDataset(scenes=6, frames=3)
Labels = np.ndarray[tuple[int, ...], np.dtype[np.uint8]]


@dataclass(frozen=True)
class Released:
    """A platform with the twin, the sequences' ids by name, and the ZIP it came from."""

    platform: Platform
    owner: Person
    sequences: dict[str, str]
    zip_path: Path

    def published(self) -> dict[str, dict[str, Labels]]:
        """The arrays `label` of the ZIP by scene and token, as zipfile and NumPy read them."""
        found: dict[str, dict[str, Labels]] = {}
        with zipfile.ZipFile(self.zip_path) as archive:
            for name in archive.namelist():
                if name.endswith("/labels.npz"):
                    scene, token = name.split("/")[-3:-1]
                    with np.load(io.BytesIO(archive.read(name))) as arrays:
                        found.setdefault(scene, {})[token.replace("-", "")] = arrays["label"]
        return found


@pytest.fixture(scope="module")
def released(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Released]:
    platform = opened(make_settings(tmp_path_factory.mktemp("released")), [])
    upgrade(platform.settings)
    path = write_released_zip(tmp_path_factory.mktemp("published") / "STONE.zip", WHAT)
    owner = person(platform, "curator")
    brought = bring_dataset(platform, path, owner.user_id)
    run_all(platform)
    assert brought.run().state == "succeeded", brought.run().failure
    with platform.database.reading() as session:
        sequences = {row.name: row.id for row in session.scalars(select(SequenceRow).order_by(SequenceRow.name))}
    yield Released(platform, owner, sequences, path)
    platform.database.close()


def test_label_sets_have_the_releases_grid_and_its_labels(released: Released) -> None:
    with released.platform.database.reading() as session:
        grids = {recorded_grid(one.grid) for one in session.scalars(select(LabelSet))}
        scenes = select(Blob.object_key).join(Artefact, Artefact.blob_sha256 == Blob.sha256)
        key = session.scalars(scenes.where(Artefact.name == "scene/scene.json").limit(1)).one()
    assert grids == {RELEASE}
    scene = json.loads(b"".join(released.platform.store.read(key)))
    assert scene["grid"] == {"name": "release", "shape": [200, 200, 16], "min_m": [-40.0, -40.0, -1.0], "voxel_m": 0.4}
    files = files_of(released.platform, released.owner.user_id)
    for name, frames in released.published().items():
        for token, label in frames.items():
            semantics, observed = read_grids(files[f"{name}/{token}/labels.npz"], ("semantics", "mask_lidar"))
            np.testing.assert_array_equal(semantics, np.where(label == 255, 0, label))
            np.testing.assert_array_equal(observed, label != 255)


def test_a_board_over_it_scores_at_its_grid(released: Released, tmp_path: Path) -> None:
    platform, published = released.platform, released.published()
    administrator, captain = person(platform, "administrator"), person(platform, "participant")
    names = list(released.sequences)
    parts = dict(zip(("train", "val", "test"), (names[:2], names[2:4], names[4:]), strict=True))
    ids = {part: [released.sequences[name] for name in of_part] for part, of_part in parts.items()}
    version = dataset(platform, administrator.user_id, ids)
    benchmark, phases = benchmark_over(platform, administrator, version)
    with platform.database.reading() as session:
        phase = session.get_one(Phase, phases["test"])
        assert recorded_grid(session.get_one(Dataset, phase.dataset_id).grid) == RELEASE
    truth = {part: {name: published[name] for name in of_part} for part, of_part in parts.items()}
    team = team_led_by(platform, captain)
    at = (administrator, released.owner, (captain,), captain, (team,))
    world = World(platform, *at, benchmark, version, phases["val"], phases["test"], truth, RELEASE)
    perfect = {token: np.where(one == 255, 0, one).astype(np.uint8) for token, one in world.truth("test").items()}
    shifted = {token: np.roll(one, 1, axis=0) for token, one in perfect.items()}
    found = []
    for number, frames in enumerate((perfect, shifted)):
        write_submission(tmp_path / f"{number}.zip", frames.items(), RELEASE)
        submission_id = send(world, (tmp_path / f"{number}.zip").read_bytes(), part="test")
        run_eval(platform)
        (score,) = scores_of(platform, submission_id)
        found.append(score.iou_occ)
    assert found[0] == 1.0
    hit = sum(((perfect[token] > 0) & (shifted[token] > 0)).sum() for token in perfect)
    either = sum(((perfect[token] > 0) | (shifted[token] > 0)).sum() for token in perfect)
    assert found[1] == pytest.approx(hit / either, rel=1e-12)


def export_of(released: Released, name: str, form: str) -> dict[str, bytes]:
    """The files of an export of this sequence, which succeeds."""
    with released.platform.database.transaction() as session:
        export, job = start_export(session, session.get_one(SequenceRow, released.sequences[name]), form)
        export_id, job_id = export.id, job.id
    run_all(released.platform)
    with released.platform.database.reading() as session:
        assert session.get_one(Job, job_id).state == "succeeded", session.get_one(Job, job_id).failure
    return exported_files(released.platform, export_id)


def test_an_export_gives_every_label_back_byte_for_byte(released: Released) -> None:
    name, compared = next(iter(released.sequences)), 0
    files = export_of(released, name, "nuscenes")
    with zipfile.ZipFile(released.zip_path) as archive:
        for entry in archive.namelist():
            if f"/gts/{name}/" in entry and entry.endswith("labels.npz"):
                assert files[entry[entry.index("gts/") :]] == archive.read(entry)
                compared += 1
    assert compared == WHAT.frames


@pytest.mark.parametrize("form", [form for form in FORMATS if form != "nuscenes"])
def test_every_format_finds_the_sweeps_of_frames_whose_tokens_have_dashes(released: Released, form: str) -> None:
    files = export_of(released, next(iter(released.sequences)), form)
    assert files
    if form == "kitti":
        scans = [content for name, content in files.items() if "/velodyne/" in name]
        with zipfile.ZipFile(released.zip_path) as archive:
            sweeps = [archive.read(name) for name in sorted(archive.namelist()) if "LIDAR_TOP" in name]
        returns = [np.isfinite(np.frombuffer(one, "<f4").reshape(-1, 5)[:, 0]).sum() for one in sweeps[: WHAT.frames]]
        assert [len(one) // 16 for one in scans] == returns
