"""What our exporter wrote of a labelled drive is imported without the change of a byte.

Catches alone an importer that alters what our own export says: tables, files, labels, tokens, poses.
"""

from pathlib import Path

import numpy as np
import pytest

from services.labeler.exports.folder import ExportRequest, export
from services.labeler.run_answers import PublicationAnswer
from testing.worlds.imported import artefacts_of, write_import
from tests.services.labeler.exports.conftest import drive
from tests.services.labeler.exports.made import Labelled, unheard
from tests.services.labeler.imports.test_scene_import import labels_of, sequence_in, source_of

pytestmark = pytest.mark.whole

__all__ = ["drive"]  # a fixture


@pytest.fixture(scope="module")
def exported(drive: Labelled, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """As `stone export --format nuscenes` leaves it."""
    folder = tmp_path_factory.mktemp("exported") / "nuscenes"
    export(ExportRequest("nuscenes", folder, drive.report), drive.source, unheard)
    return folder


@pytest.fixture(scope="module")
def told(exported: Path) -> PublicationAnswer:
    (answer,) = write_import(exported, exported.parent / "imported")
    return answer


def test_source_and_labels_are_the_files_of_the_export(exported: Path, told: PublicationAnswer) -> None:
    out = artefacts_of(exported.parent / "imported")
    name = sequence_in(out).name
    labels = zip(told.tokens, labels_of(out, told), strict=True)
    files = source_of(out) | {f"gts/{name}/{token}/labels.npz": content for token, content in labels}
    own = ("export.json", "checksums", "tables")
    published = {
        path.relative_to(exported).as_posix(): path.read_bytes()
        for path in exported.rglob("*")
        if path.is_file() and path.relative_to(exported).parts[0] not in own
    }
    assert sorted(files) == sorted(published)
    assert [name for name in files if files[name] != published[name]] == []


def test_frames_have_the_tokens_stamps_and_poses_that_were_exported(
    exported: Path, drive: Labelled, told: PublicationAnswer
) -> None:
    found, source = sequence_in(artefacts_of(exported.parent / "imported")), drive.source().sequence
    assert found.name == source.name
    assert tuple(told.tokens) == found.frames.tokens == source.frames.tokens
    assert np.array_equal(found.frames.stamps_ns, source.frames.stamps_ns // 1000 * 1000)
    assert np.array_equal(found.frames.map_from_ego.wxyz, source.frames.map_from_ego.wxyz)
    moved_m = found.frames.map_from_ego.translation_m - source.frames.map_from_ego.translation_m
    assert np.allclose(moved_m, np.round(moved_m[0]), atol=1e-9)


def test_the_map_has_the_voxels_that_the_frames_show(exported: Path, drive: Labelled, told: PublicationAnswer) -> None:
    """Totals of voxels are those of the label set that was exported."""
    counts = np.zeros(4, np.int64)
    for token in told.tokens:
        with np.load(drive.folder / "gts" / drive.source().sequence.name / token / "labels.npz") as arrays:
            counts += np.bincount(arrays["semantics"].reshape(-1), minlength=4)
    totals = told.totals
    assert [totals.free_voxels, totals.t_voxels, totals.p_voxels, totals.n_voxels] == counts.tolist()
