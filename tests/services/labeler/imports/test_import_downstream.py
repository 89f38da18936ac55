"""What works on labels that were made here works on imported ones: formats, inputs, comparisons.

Catches alone (20 s) a stage that asks an imported label set for a recording.
"""

import io
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from sqlalchemy import select

from services.domain.datasets.input_jobs import located_input, start_version_inputs
from services.domain.datasets.queries import dataset_named
from services.domain.exports.requests import start_export
from services.domain.sequences.label_comparisons import start_comparison
from services.domain.sequences.label_sources import SOURCE_INDEX, has_samples, is_imported
from services.domain.viewer.playback import playback_of
from services.runtime.database.migrate import upgrade
from services.runtime.orm import Artefact, Job, LabelComparison, LabelledFrameRow, LabelSet, SequenceRow
from services.runtime.platform import Platform
from services.runtime.settings import ViewingSettings
from stone_exports.frames import frames_in
from stone_exports.labels import observed_classes
from stone_exports.tables import exports_in
from testing.refusals import refused_as
from testing.servers.fixtures import make_settings, opened
from testing.worlds.benchmark_world import run_eval
from testing.worlds.brought_datasets import an_owner, bring_dataset
from testing.worlds.drives import exported_files, files_at
from testing.worlds.published import dataset
from testing.worlds.published_datasets import SyntheticDataset, made_labels, write_published, write_published_tar
from testing.worlds.runs import run_all

pytestmark = pytest.mark.whole

LABELS = tuple(made_labels(seed) for seed in range(3))
SCENES = SyntheticDataset(scenes=3, cameras=("CAM_FRONT",), labels=LABELS)
PARTS = dict(zip(("train", "val", "test"), SCENES.names, strict=True))


@dataclass(frozen=True)
class Downstream:
    """A platform with an imported dataset; the scenes' sequences and label sets by name."""

    platform: Platform
    owner_id: str
    sequences: Mapping[str, str]
    label_sets: Mapping[str, str]

    def exported(self, form: str, name: str = SCENES.names[0]) -> dict[str, bytes]:
        """The files of an export, which succeeds."""
        with self.platform.database.transaction() as session:
            export, job = start_export(session, session.get_one(SequenceRow, self.sequences[name]), form)
            export_id, job_id = export.id, job.id
        run_all(self.platform)
        with self.platform.database.reading() as session:
            assert session.get_one(Job, job_id).state == "succeeded", session.get_one(Job, job_id).failure
        return exported_files(self.platform, export_id)

    def version(self) -> str:
        """The name of a version with a scene in each part."""
        return dataset(self.platform, self.owner_id, {part: [self.sequences[name]] for part, name in PARTS.items()})


@pytest.fixture(scope="module")
def imported(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Downstream]:
    """Read by all tests; what they add stands beside."""
    platform = opened(
        make_settings(tmp_path_factory.mktemp("imported"), viewing=ViewingSettings(makes_playback=True)), []
    )
    upgrade(platform.settings)
    tar = write_published_tar(tmp_path_factory.mktemp("published") / "field.tar", SCENES)
    brought = bring_dataset(platform, tar, an_owner(platform))
    run_all(platform)
    assert brought.run().state == "succeeded", brought.run().failure
    with platform.database.reading() as session:
        sequences = {row.name: row.id for row in session.scalars(select(SequenceRow))}
        sets = {row.sequence_id: row.id for row in session.scalars(select(LabelSet))}
    yield Downstream(platform, brought.owner_id, sequences, {name: sets[one] for name, one in sequences.items()})
    platform.database.close()


def test_nuscenes_has_every_file_of_the_scene_as_it_was_published(imported: Downstream, tmp_path: Path) -> None:
    folder, name = write_published(tmp_path / "published", SCENES), SCENES.names[1]
    files = imported.exported("nuscenes", name)
    of_scene = {f"{SCENES.stamp_us(1, frame) + later}" for frame in range(3) for later in (0, 20_000)}
    for path in (*folder.glob("samples/*/*"), *folder.glob(f"gts/{name}/*/labels.npz")):
        relative = path.relative_to(folder).as_posix()
        if relative.startswith("gts/") or path.name.split("__")[-1].split(".")[0] in of_scene:
            assert files[relative] == path.read_bytes(), relative
    rows = json.loads(files["v1.0-trainval/sample.json"])
    assert tuple(row["token"] for row in rows) == SCENES.tokens(1)


def test_pictures_of_the_viewer_follow_the_import_by_themselves(imported: Downstream) -> None:
    with imported.platform.database.reading() as session:
        playback = playback_of(session, imported.label_sets[SCENES.names[2]])
    assert playback.state == "ready"


def test_labels_have_samples_as_long_as_their_source_is_kept(imported: Downstream) -> None:
    """A label set of an imported sequence that has neither source nor recording is refused as one whose bag is gone."""
    name = SCENES.names[0]
    with imported.platform.database.transaction() as session:
        sequence_id, label_set_id = imported.sequences[name], imported.label_sets[name]
        assert is_imported(session, label_set_id)
        assert has_samples(session, sequence_id, label_set_id)
        of_set = select(Artefact).where(Artefact.label_set_id == label_set_id, Artefact.name == SOURCE_INDEX)
        session.delete(session.scalars(of_set).one())
        session.flush()
        assert not has_samples(session, sequence_id, label_set_id)
        with refused_as("nothing_to_export"):
            start_export(session, session.get_one(SequenceRow, sequence_id), "kitti")
        session.rollback()


def test_inputs_of_a_version_are_what_a_model_reads_beside_the_labels(imported: Downstream, tmp_path: Path) -> None:
    """As participants have it: inputs unpacked, labels unpacked into the same folder, read by what baselines read."""
    name = imported.version()
    with imported.platform.database.transaction() as session:
        version = dataset_named(session, name)
        assert version is not None
        start_version_inputs(session, version, imported.owner_id)
    run_all(imported.platform)
    with imported.platform.database.reading() as session:
        version = dataset_named(session, name)
        assert version is not None
        found = located_input(session, version, PARTS["train"])
    assert found is not None
    files = files_at(imported.platform, found[1])
    assert {one.split("/")[0] for one in files} == {"v1.0-trainval", "samples", "maps", "sha256sum.txt"}
    labels = {f"gts/{PARTS['train']}/{token}/labels.npz": LABELS[at] for at, token in enumerate(SCENES.tokens(0))}
    for one, content in (files | labels).items():
        (tmp_path / one).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / one).write_bytes(content)
    (export,) = exports_in(tmp_path)
    frames = frames_in(export)
    assert tuple(frame.token for frame in frames) == SCENES.tokens(0)
    assert all(frame.data.keys() == SCENES.sensors.keys() for frame in frames)
    for frame, content in zip(frames, LABELS, strict=True):
        assert frame.labels is not None
        with np.load(io.BytesIO(content)) as arrays:
            seen = arrays["mask_lidar"] > 0
            assert np.array_equal(observed_classes(frame.labels)[seen], arrays["semantics"][seen])


def test_labels_imported_again_beside_a_sequence_compare_as_equal(imported: Downstream, tmp_path: Path) -> None:
    """The dataset's tar is another, so the label set is another, of the same frames."""
    tar = write_published_tar(tmp_path / "again.tar", SyntheticDataset(scenes=1, cameras=("CAM_FRONT",), labels=LABELS))
    again = bring_dataset(imported.platform, tar, imported.owner_id, existing="add")
    run_all(imported.platform)
    assert again.run().state == "succeeded", again.run().failure
    sequence_id = imported.sequences[SCENES.names[0]]
    with imported.platform.database.transaction() as session:
        sets = session.scalars(select(LabelSet.id).where(LabelSet.sequence_id == sequence_id)).all()
        assert len(sets) == 2
        comparison_id = start_comparison(session, session.get_one(SequenceRow, sequence_id), *sets)[0].id
    run_eval(imported.platform)
    with imported.platform.database.reading() as session:
        record = session.get_one(LabelComparison, comparison_id).record
        tokens = session.scalars(select(LabelledFrameRow.token)).all()
    assert record is not None
    assert (record["frames"], record["has_equal_classes"]) == (3, True)
    assert set(SCENES.tokens(0)) <= set(tokens)
