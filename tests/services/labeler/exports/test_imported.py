"""Exports of an imported label set: `nuscenes` gives back every byte, the others say what they said of the recording.

Catches alone (10 s) samples that come out of an imported source otherwise than they went into it.
"""

import io
import json
import pickle
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from services.labeler.exports.dataset_source import DatasetSource
from services.labeler.exports.kitti import write_kitti
from services.labeler.exports.nuscenes.layout import write_nuscenes
from services.labeler.exports.playback import write_playback
from services.labeler.exports.registry import EXPORTERS, Write
from services.labeler.exports.sandboxed_export import DatasetSamples, write_inputs
from services.labeler.exports.source import LabelledSequence
from services.runtime.store.packs import index_bytes, pack_folder
from stone_exports.files import DamagedExportError
from stone_exports.frames import frames_in
from stone_exports.tables import exports_in
from stone_recordings.sync.samples import jpeg_of
from testing.worlds.published_datasets import SyntheticDataset, made_labels, write_annotated
from tests.services.labeler.exports.imported import Imported, again, imported
from tests.services.labeler.exports.made import Labelled, files_of, unheard
from tests.services.runtime.view_decoding import Read

pytestmark = pytest.mark.whole


@dataclass(frozen=True)
class Pair:
    """A labelled sequence with its recording, and the same as it was imported."""

    recorded: LabelledSequence
    dataset: Imported

    @property
    def imported(self) -> LabelledSequence:
        return self.dataset.labelled


@pytest.fixture(scope="module")
def pair(drive: Labelled, tmp_path_factory: pytest.TempPathFactory) -> Pair:
    recorded = drive.source()
    return Pair(recorded, again(recorded, tmp_path_factory.mktemp("again")))


def both(pair: Pair, write: Write, tmp_path: Path) -> Iterator[Path]:
    for name, source in (("recorded", pair.recorded), ("imported", pair.imported)):
        out = tmp_path / name
        out.mkdir()
        write(source, out, unheard)
        yield out


def test_nuscenes_of_imported_labels_is_what_was_published_byte_for_byte(pair: Pair, tmp_path: Path) -> None:
    out = tmp_path / "again"
    out.mkdir()
    write_nuscenes(pair.imported, out, unheard)
    assert files_of(out) == files_of(pair.dataset.published)


def test_radar_scans_come_back_with_their_rates(pair: Pair) -> None:
    """A PCD keeps four bytes a number, and times keep microseconds."""
    seen = 0
    for mount in pair.recorded.sequence.calibration.of_kind("radar"):
        for index in range(len(pair.recorded.sequence.frames)):
            ours, theirs = (one.samples.radar(mount.name, index) for one in (pair.recorded, pair.imported))
            assert (ours is None) == (theirs is None)
            if ours is not None and theirs is not None:
                assert np.allclose(ours.points_radar, theirs.points_radar, atol=1e-5)
                assert np.allclose(ours.points_lidar, theirs.points_lidar, atol=1e-4, equal_nan=True)
                assert np.allclose(ours.range_rate_m_s, theirs.range_rate_m_s, atol=1e-5)
                assert np.allclose(ours.ground_rate_m_s, theirs.ground_rate_m_s, atol=1e-5)
                assert np.array_equal(ours.rcs_db, theirs.rcs_db)
                seen += len(ours.rcs_db)
    assert seen > 100


def test_a_radar_that_says_no_measured_velocity_gives_it_of_the_robots_own_motion(pair: Pair, tmp_path: Path) -> None:
    """Datasets may hold `vx_comp` and `vy_comp` alone; the rate along the ray follows from where the robot drove."""
    source = altered(pair.dataset.published, tmp_path, (b" vx vy ", b" ax ay "), ".pcd")
    samples = DatasetSamples(source, pair.imported.sequence)
    (mount, *_) = pair.imported.sequence.calibration.of_kind("radar")
    said, followed = (one.radar(mount.name, 5) for one in (pair.imported.samples, samples))
    assert said is not None
    assert followed is not None
    assert np.allclose(said.range_rate_m_s, followed.range_rate_m_s, atol=0.05)


def test_kitti_has_the_same_labels_and_points(pair: Pair, tmp_path: Path) -> None:
    recorded, again = (files_of(out) for out in both(pair, write_kitti, tmp_path))
    assert recorded.keys() == again.keys()
    differing = {name for name in recorded if recorded[name] != again[name]}
    assert {Path(name).name for name in differing} <= {"times.txt", "poses.txt"}
    for name in differing:
        ours, theirs = (np.array(files[name].split(), np.float64) for files in (recorded, again))
        assert np.allclose(ours, theirs, atol=1.1e-6)


def test_playback_has_the_same_clouds_and_pictures(pair: Pair, tmp_path: Path) -> None:
    recorded, again = (files_of(out) for out in both(pair, write_playback, tmp_path))
    before, after = (json.loads(files.pop("playback.json")) for files in (recorded, again))
    ours, theirs = (cameras_in(files.pop("cameras.bin")) for files in (recorded, again))
    order = [after["cameras"].index(channel) for channel in before["cameras"]]
    for mine, its in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(mine, its[order], atol=2e-4)  # stamps of a dataset are microseconds
    assert recorded == again
    placed, again_placed = (
        {one["channel"]: one["ego_from_sensor"] for one in record.pop("sensors") if one["kind"] not in ("ins", "imu")}
        for record in (before, after)
    )
    assert set(placed) == set(again_placed)
    for channel, pose in placed.items():
        np.testing.assert_allclose(pose, again_placed[channel], atol=1e-9)
    assert {**before, "cameras": sorted(before["cameras"])} == {**after, "cameras": sorted(after["cameras"])}


def cameras_in(content: bytes) -> tuple[np.ndarray, ...]:
    """Pictures, rays and poses of `STR1`, the camera first."""
    read = Read(content, b"STR1")
    cameras, frames, columns, rows = read.values("I", 4)
    shapes = (("B", (cameras, frames)), ("f", (cameras, rows, columns, 3)), ("f", (cameras, frames, 7)))
    return tuple(np.array(read.values(code, int(np.prod(shape)))).reshape(shape) for code, shape in shapes)


def test_inputs_have_the_same_frames_and_files_as_those_of_the_recording(pair: Pair, tmp_path: Path) -> None:
    (ours,), (theirs,) = (exports_in(out) for out in both(pair, write_inputs, tmp_path))
    recorded, again = frames_in(ours), frames_in(theirs)
    assert [one.token for one in again] == [one.token for one in recorded]
    for before, after in zip(recorded, again, strict=True):
        assert before.stamp_us == after.stamp_us
        assert before.data.keys() == after.data.keys()
        for channel, datum in before.data.items():
            assert after.data[channel].stamp_us == datum.stamp_us
            if datum.sensor.modality != "radar":
                assert after.data[channel].span.read(1 << 28) == datum.span.read(1 << 28)
            moved = datum.global_from_ego.inverse() @ before.lidar.global_from_ego
            expected = after.data[channel].global_from_ego.inverse() @ after.lidar.global_from_ego
            assert np.allclose(moved.as_matrix(), expected.as_matrix(), atol=1e-5)


def test_nothing_planted_in_the_dataset_reaches_inputs(pair: Pair, tmp_path: Path) -> None:
    """Boxes, point labels and words of classes are in the source, and none of them is in the inputs."""
    planted = b"0123456789abcdef-planted"
    dataset = imported(planted_dataset(pair.dataset.published, tmp_path / "planted", planted), tmp_path / "imported")
    assert any(planted in pack.read_bytes() for pack in dataset.source.packs), "the source has them"
    out = tmp_path / "inputs"
    out.mkdir()
    write_inputs(dataset.labelled, out, unheard)
    files = files_of(out)
    assert {name.split("/")[0] for name in files} == {"v1.0-trainval", "samples", "maps"}
    assert not any(planted in content or planted in name.encode() for name, content in files.items())
    assert json.loads(files["v1.0-trainval/sample_annotation.json"]) == []
    assert json.loads(files["v1.0-trainval/instance.json"]) == []
    (mask,) = (content for name, content in files.items() if name.startswith("maps/"))
    assert mask not in set(files_of(pair.dataset.published).values())


def test_samples_can_be_given_to_another_process(pair: Pair) -> None:
    again = pickle.loads(pickle.dumps(DatasetSamples(pair.dataset.source, pair.imported.sequence)))
    assert np.array_equal(again.lidar(0).points_lidar, pair.imported.samples.lidar(0).points_lidar)


def test_a_file_that_the_tables_name_and_the_packs_lack_is_refused(pair: Pair, tmp_path: Path) -> None:
    source = altered(pair.dataset.published, tmp_path, (b"__LIDAR_TOP__", b"__LIDAR_GONE__"), "sample_data.json")
    samples = DatasetSamples(source, pair.imported.sequence)
    with pytest.raises(DamagedExportError, match="which does not exist"):
        samples.lidar(0)


def test_a_frame_that_has_no_sweep_is_refused(pair: Pair, tmp_path: Path) -> None:
    source = altered(pair.dataset.published, tmp_path, (b'"is_key_frame":true', b'"is_key_frame":false'), ".json")
    with pytest.raises(DamagedExportError, match="frame 3 has no sweep of LIDAR_TOP"):
        DatasetSamples(source, pair.imported.sequence).lidar(3)


def test_a_picture_that_is_no_jpeg_is_encoded_once_as_those_of_recordings_are(pair: Pair, tmp_path: Path) -> None:
    ours = pair.imported.samples.camera("CAM_FRONT", 0)
    assert ours is not None
    png = io.BytesIO()
    Image.open(io.BytesIO(ours.content)).save(png, "PNG")
    source = altered(pair.dataset.published, tmp_path, (ours.content, png.getvalue()), ".jpg")
    sample = DatasetSamples(source, pair.imported.sequence).camera("CAM_FRONT", 0)
    assert sample is not None
    assert (sample.width_px, sample.height_px) == (ours.width_px, ours.height_px)
    with Image.open(io.BytesIO(sample.content)) as again, Image.open(png) as original:
        assert again.format == "JPEG"
        assert np.abs(np.asarray(again, np.int64) - np.asarray(original, np.int64)).mean() < 4
    assert jpeg_of(png.getvalue())[0] == sample.content


@pytest.fixture(scope="module")
def without_lidar(tmp_path_factory: pytest.TempPathFactory) -> Imported:
    """Occ3D's layout: pictures and labels, no sweeps."""
    root = tmp_path_factory.mktemp("annotated")
    what = SyntheticDataset(scenes=1, cameras=("CAM_FRONT",), radars=(), labels=[made_labels()])
    return imported(write_annotated(root / "published", what), root / "imported")


@pytest.mark.parametrize("form", list(EXPORTERS))
def test_every_format_is_written_of_a_dataset_without_a_lidar(
    without_lidar: Imported, tmp_path: Path, form: str
) -> None:
    EXPORTERS[form](without_lidar.labelled, tmp_path, unheard)
    files = files_of(tmp_path)
    assert files
    assert not any("LIDAR" in name for name in files)


def test_a_dataset_without_a_lidar_has_inputs_of_its_cameras_and_no_clouds(
    without_lidar: Imported, tmp_path: Path
) -> None:
    for name, write in (("inputs", write_inputs), ("playback", write_playback)):
        (tmp_path / name).mkdir()
        write(without_lidar.labelled, tmp_path / name, unheard)
    rows = json.loads((tmp_path / "inputs" / "v1.0-trainval" / "sensor.json").read_bytes())
    assert [row["channel"] for row in rows] == ["CAM_FRONT"]
    assert len(list((tmp_path / "inputs" / "samples" / "CAM_FRONT").iterdir())) == 3
    shown = json.loads((tmp_path / "playback" / "playback.json").read_bytes())
    assert (shown["has_clouds"], shown["has_radars"]) == (False, False)
    assert [one["channel"] for one in shown["sensors"]] == ["CAM_FRONT"]
    assert without_lidar.labelled.samples.radar("RADAR_FRONT", 0) is None
    assert without_lidar.labelled.samples.camera("CAM_BACK", 0) is None


def altered(folder: Path, root: Path, change: tuple[bytes, bytes], ending: str) -> DatasetSource:
    """A source in which files of this ending say something else, as none is that was imported whole."""
    for name, content in files_of(folder).items():
        if not name.startswith("gts/"):
            path = root / "altered" / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content.replace(*change) if name.endswith(ending) else content)
    packed = pack_folder(root / "altered", root / "packed", unheard, pack_bytes=1 << 18)
    (root / "packed" / "index.npz").write_bytes(index_bytes(packed))
    return DatasetSource(root / "packed" / "index.npz", tuple(sorted((root / "packed").glob("*.pack"))))


def planted_dataset(folder: Path, root: Path, planted: bytes) -> Path:
    """The dataset with what could tell of labels: boxes, point labels, and a word in every row of every table."""
    for name, content in files_of(folder).items():
        said = content.replace(b'{"token":', b'{"drivable":"%s","token":' % planted)
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_bytes(said if name.startswith("v1.0-trainval/") else content)
    (token,) = {row["token"] for row in json.loads((root / "v1.0-trainval" / "sample.json").read_bytes())[:1]}
    box = {"token": "b" * 32, "sample_token": token, "planted": planted.decode()}
    (root / "v1.0-trainval" / "sample_annotation.json").write_text(json.dumps([box]))
    (root / "v1.0-trainval" / "lidarseg.json").write_text(json.dumps([{**box, "filename": "lidarseg/0.bin"}]))
    (root / "lidarseg").mkdir()
    (root / "lidarseg" / "0.bin").write_bytes(planted)
    return root
