"""A run that was labelled here, exported, and imported again beside itself: equal labels, and the same export.

Catches alone (30 s) an export, an import and a comparison that do not agree on what a frame is.
"""

import tarfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from sqlalchemy import select

from services.domain.exports.requests import counting_labels, start_export
from services.domain.sequences.label_comparisons import start_comparison
from services.domain.sequences.label_sources import is_imported
from services.runtime.database.migrate import upgrade
from services.runtime.orm import Export, LabelComparison, LabelledFrameRow, LabelSet, SequenceRow
from services.runtime.platform import Platform
from services.runtime.store.pack_archive import archive_of, locate_export, stored_files
from services.runtime.store.pack_reading import archive_pieces
from simulator.options import SimulateOptions
from simulator.pipeline import simulate
from testing.servers.fixtures import make_settings, opened
from testing.worlds.benchmark_world import run_eval
from testing.worlds.brought_datasets import bring_dataset
from testing.worlds.runs import Brought, bring_ready, run_all

pytestmark = pytest.mark.whole

RUN = SimulateOptions(seconds=2.0, seed=3, channels=16, columns=180, camera_width_px=96)


@dataclass(frozen=True)
class Beside:
    """A sequence with the labels that were made here and those of their export, imported; `tar` is that export."""

    brought: Brought
    tar: Path
    ours: str
    theirs: str

    @property
    def platform(self) -> Platform:
        return self.brought.platform


@pytest.fixture(scope="module")
def beside(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Beside]:
    folder = tmp_path_factory.mktemp("beside")
    simulate(folder / "run.mcap", RUN)
    platform = opened(make_settings(folder / "platform"), [])
    upgrade(platform.settings)
    brought = bring_ready(platform, folder / "run.mcap")
    brought.process()
    run_all(platform)
    (ours,) = brought.label_sets()
    tar = exported(brought, folder / "run.tar")
    dataset = bring_dataset(platform, tar, brought.owner_id, existing="add")
    run_all(platform)
    assert dataset.run().state == "succeeded", dataset.run().failure
    (theirs,) = (row for row in brought.label_sets() if row.id != ours.id)
    yield Beside(brought, tar, ours.id, theirs.id)
    platform.database.close()


def exported(brought: Brought, tar: Path) -> Path:
    """The tar of the nuScenes export of the labels that count, as a server gives it."""
    platform = brought.platform
    with platform.database.transaction() as session:
        export, job = start_export(session, session.get_one(SequenceRow, brought.sequence_id), "nuscenes")
        export_id, job_id = export.id, job.id
    run_all(platform)
    assert brought.job(job_id).state == "succeeded", brought.job(job_id).failure
    with platform.database.reading() as session:
        stored = stored_files(platform.store, locate_export(session, session.get_one(Export, export_id)))
    archive = archive_of(stored.files, "tar")
    with tar.open("wb") as file:
        for piece in archive_pieces(stored.files, archive, (0, archive.size_bytes), stored.reader(platform.store)):
            file.write(piece)
    return tar


def test_the_two_compare_as_equal_in_every_frame(beside: Beside) -> None:
    with beside.platform.database.transaction() as session:
        sequence = session.get_one(SequenceRow, beside.brought.sequence_id)
        comparison_id = start_comparison(session, sequence, beside.ours, beside.theirs)[0].id
    run_eval(beside.platform)
    with beside.platform.database.reading() as session:
        record = session.get_one(LabelComparison, comparison_id).record
        frames = session.get_one(LabelSet, beside.ours).frames
    assert record is not None
    assert (record["frames"], record["only_in_a"], record["only_in_b"]) == (frames, 0, 0)
    assert record["has_equal_classes"]


def test_tokens_and_label_files_of_the_two_are_the_same(beside: Beside) -> None:
    def frames(label_set_id: str) -> list[LabelledFrameRow]:
        of_set = select(LabelledFrameRow).where(LabelledFrameRow.label_set_id == label_set_id)
        with beside.platform.database.reading() as session:
            return list(session.scalars(of_set.order_by(LabelledFrameRow.ordinal)))

    ours, theirs = frames(beside.ours), frames(beside.theirs)
    assert [row.token for row in theirs] == [row.token for row in ours]
    assert [row.sha256 for row in theirs] == [row.sha256 for row in ours]
    assert [row.stamp_ns for row in theirs] == [row.stamp_ns // 1000 * 1000 for row in ours]


def test_the_imported_labels_count_and_exported_again_they_are_the_same_tar(beside: Beside, tmp_path: Path) -> None:
    with beside.platform.database.reading() as session:
        counting = counting_labels(session, beside.brought.sequence_id)
        assert counting is not None
        assert (counting.id, is_imported(session, counting.id)) == (beside.theirs, True)
        assert not is_imported(session, beside.ours)
    again = exported(beside.brought, tmp_path / "again.tar")
    assert files_in(again) == files_in(beside.tar)
    assert again.read_bytes() == beside.tar.read_bytes()


def files_in(tar: Path) -> dict[str, bytes]:
    with tarfile.open(tar) as archive:
        members = {one.name: archive.extractfile(one) for one in archive.getmembers() if one.isfile()}
        return {name: file.read() for name, file in members.items() if file is not None}
