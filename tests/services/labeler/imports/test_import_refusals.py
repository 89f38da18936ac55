"""What an import refuses, by its code, and answers of children that are not believed; nothing is left of either."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from sqlalchemy import select

from services.domain.imports.requests import INDEX, PUBLISH_IMPORT
from services.labeler.child_answers import PublicationAnswer
from services.labeler.imports import index_stage, scene_stage
from services.labeler.imports.answers import DatasetIndexAnswer
from services.labeler.imports.indexing import index_dataset
from services.labeler.imports.scene_import import import_scene
from services.labeler.imports.scene_parts import DatasetOpening, SceneOpening, scene_folder
from services.labeler.imports.scene_stage import answer_path
from services.runtime.jobs.specs import Attempt, Handler, Outcome
from services.runtime.orm import Blob, DatasetImport
from services.runtime.platform import Platform
from services.runtime.sandbox import ProgressCallback
from services.runtime.store.workspace import Workspace
from services.runtime.uploads import upload_file
from testing.worlds.brought_datasets import an_owner, bring_dataset, counts_of
from testing.worlds.decay import decay
from testing.worlds.published_datasets import SyntheticDataset, made_labels, write_published_tar
from testing.worlds.runs import Wrap, run_all, unchanged

ONE = SyntheticDataset(scenes=1, frames=2, cameras=("CAM_FRONT",), radars=(), labels=(made_labels(),))
Tamper = Callable[[Path], object]


class NamedDataset(SyntheticDataset):
    """Scenes whose names no sequence can have."""

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"the field, {scene}" for scene in range(self.scenes))


@pytest.fixture(scope="module")
def tar(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_published_tar(tmp_path_factory.mktemp("published") / "one.tar", ONE)


def refused(platform: Platform, path: Path, wrap: Wrap = unchanged) -> tuple[str, str]:
    """The code and the sentence by which the import of a tar failed; of what it would have made nothing is there."""
    brought = bring_dataset(platform, path, an_owner(platform))
    run_all(platform, wrap=wrap)
    counts = counts_of(platform, brought.owner_id)
    assert (counts["sequences"], counts["label_sets"], counts["artefacts"]) == (0, 0, 0)
    assert brought.run().state == "failed"
    return brought.run().failure_code, brought.run().failure


def test_a_scene_that_no_sequence_can_be_called_as_is_named(platform: Platform, tmp_path: Path) -> None:
    what = NamedDataset(scenes=2, frames=1, cameras=(), radars=(), labels=ONE.labels)
    code, sentence = refused(platform, write_published_tar(tmp_path / "named.tar", what))
    assert (code, "'the field, 0'" in sentence) == ("DST-019", True)


def test_scenes_without_labels_are_named(platform: Platform, tmp_path: Path) -> None:
    code, sentence = refused(platform, write_published_tar(tmp_path / "test.tar", replace(ONE, labels=())))
    assert (code, ONE.names[0] in sentence) == ("scenes_unlabelled", True)


def test_more_than_the_owner_may_have_is_not_published(platform: Platform, tar: Path) -> None:
    uploads = replace(platform.settings.uploads, owner_bytes=1)
    small = replace(platform, settings=platform.settings.model_copy(update={"uploads": uploads}))
    assert refused(small, tar)[0] == "quota_exceeded"


def test_a_tar_that_is_not_here_is_asked_for_again(platform: Platform, tar: Path) -> None:
    brought = bring_dataset(platform, tar, an_owner(platform))
    upload_file(platform.settings, brought.row().upload_id).unlink()
    run_all(platform)
    assert brought.run().failure_code == "recording_file_missing"


def test_a_tar_that_changed_on_the_disk_is_refused(platform: Platform, tar: Path) -> None:
    brought = bring_dataset(platform, tar, an_owner(platform))
    with upload_file(platform.settings, brought.row().upload_id).open("ab") as file:
        file.write(b"more")
    run_all(platform)
    assert brought.run().failure_code == "recording_changed"


def test_an_archive_that_decayed_in_the_store_is_the_platforms_fault(platform: Platform, tar: Path) -> None:
    brought = bring_dataset(platform, tar, an_owner(platform))

    def rotting(kind: str, handler: Handler) -> Handler:
        def run(attempt: Attempt) -> Outcome:
            if attempt.job_id not in decayed:
                decayed.add(attempt.job_id)
                with platform.database.reading() as session:
                    kept = select(Blob.object_key).join(DatasetImport, DatasetImport.blob_sha256 == Blob.sha256)
                    key = session.scalars(kept).one()
                decay(platform, key, 0.0)  # the checksum of the first header is wrong then
            return handler(attempt)

        return run if kind == INDEX else handler

    decayed = set[str]()
    run_all(platform, wrap=rotting)
    assert (brought.run().state, brought.run().failure_code) == ("failed", "object_damaged")


def leaves_no_scene(opening: DatasetOpening, folder: Path, progress: ProgressCallback) -> bytes:
    answer = index_dataset(opening, folder, progress)
    (folder / scene_folder(0)).rename(folder / "elsewhere")
    return answer


def tells_a_scene_that_is_a_path(opening: DatasetOpening, folder: Path, progress: ProgressCallback) -> bytes:
    told = DatasetIndexAnswer.model_validate_json(index_dataset(opening, folder, progress))
    return told.model_copy(update={"scenes": [told.scenes[0].model_copy(update={"name": "../up"})]}).packed()


def tells_of_another_scene(opening: DatasetOpening, folder: Path, progress: ProgressCallback) -> bytes:
    told = DatasetIndexAnswer.model_validate_json(index_dataset(opening, folder, progress))
    return told.model_copy(update={"scenes": [*told.scenes, told.scenes[0]]}).packed()


def leaves(tamper: Tamper) -> Callable[[SceneOpening, Path, ProgressCallback], bytes]:
    def work(opening: SceneOpening, folder: Path, progress: ProgressCallback) -> bytes:
        answer = import_scene(opening, folder, progress)
        tamper(folder / scene_folder(opening.ordinal) / "out")
        return answer

    return work


@pytest.mark.parametrize("work", [leaves_no_scene, tells_of_another_scene, tells_a_scene_that_is_a_path])
def test_an_index_that_is_not_as_it_says_is_not_believed(
    platform: Platform, tar: Path, monkeypatch: pytest.MonkeyPatch, work: Callable[..., bytes]
) -> None:
    monkeypatch.setattr(index_stage, "index_dataset", work)
    assert refused(platform, tar)[0] == "reader_crashed"


@pytest.mark.whole
@pytest.mark.parametrize(
    "tamper",
    [
        pytest.param(lambda out: (out / "report.json").unlink(), id="no report"),
        pytest.param(lambda out: (out / "source/index.npz").unlink(), id="no source"),
        pytest.param(lambda out: (out / "labels/000000.pack").unlink(), id="no pack"),
        pytest.param(lambda out: (out / "labels/000001.pack").write_bytes(b"x"), id="a pack nobody spoke of"),
        pytest.param(lambda out: (out / "labels/000000.pack").write_bytes(b"x"), id="a shorter pack"),
        pytest.param(lambda out: (out / ("x" * 129)).write_bytes(b"x"), id="a name without end"),
    ],
)
def test_a_scene_that_is_not_as_it_says_is_not_believed(
    platform: Platform, tar: Path, monkeypatch: pytest.MonkeyPatch, tamper: Tamper
) -> None:
    monkeypatch.setattr(scene_stage, "import_scene", leaves(tamper))
    assert refused(platform, tar)[0] == "reader_crashed"


def test_a_name_that_no_object_can_have_is_refused(
    platform: Platform, tar: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scene_stage, "import_scene", leaves(lambda out: (out / "a\nb").write_bytes(b"x")))
    assert refused(platform, tar)[0] == "bad_key"


def test_packs_other_than_those_that_are_kept_are_not_published(platform: Platform, tar: Path) -> None:
    """Catches alone frames that point beyond the end of their pack, by what lies in the workspace."""

    def wrap(kind: str, handler: Handler) -> Handler:
        def run(attempt: Attempt) -> Outcome:
            path = Workspace(platform.store, platform.settings, attempt.root_id).folder / answer_path(0)
            told = PublicationAnswer.model_validate_json(path.read_bytes())
            (pack,) = told.packs
            offset, length, digest = pack.ranges[-1]
            longer = pack.model_copy(update={"ranges": [*pack.ranges[:-1], (offset, length + 1, digest)]})
            path.write_bytes(told.model_copy(update={"packs": [longer]}).packed())
            return handler(attempt)

        return run if kind == PUBLISH_IMPORT else handler

    assert refused(platform, tar, wrap)[0] == "reader_crashed"
