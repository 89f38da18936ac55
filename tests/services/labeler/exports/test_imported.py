"""Exports of an imported label set: `nuscenes` gives back every byte, the others say what they said of the recording.

Catches alone (10 s) samples that come out of an imported source otherwise than they went into it.
"""

import json
import pickle
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from services.labeler.exports.dataset_samples import DatasetSamples
from services.labeler.exports.foxglove import write_foxglove
from services.labeler.exports.inputs import write_inputs
from services.labeler.exports.kitti import write_kitti
from services.labeler.exports.nuscenes.layout import write_nuscenes
from services.labeler.exports.playback import write_playback
from services.labeler.exports.registry import EXPORTERS
from services.labeler.exports.source import LabelledSequence
from stone_exports.files import DamagedExportError
from stone_exports.frames import frames_in
from stone_exports.tables import exports_in
from tests.services.labeler.exports.imported import Published, imported, packed_source, published
from tests.services.labeler.exports.made import Labelled, files_of, unheard

pytestmark = pytest.mark.whole


@dataclass(frozen=True)
class Pair:
    """A labelled sequence with its recording, and the same as it was imported."""

    recorded: LabelledSequence
    imported: LabelledSequence
    published: Published


@pytest.fixture(scope="module")
def pair(drive: Labelled, tmp_path_factory: pytest.TempPathFactory) -> Pair:
    recorded = drive.source()
    made = published(recorded, tmp_path_factory.mktemp("published"))
    return Pair(recorded, imported(recorded, made), made)


def both(pair: Pair, write: object, tmp_path: Path) -> Iterator[Path]:
    for name, source in (("recorded", pair.recorded), ("imported", pair.imported)):
        out = tmp_path / name
        out.mkdir()
        write(source, out, unheard)  # type: ignore[operator]
        yield out


def test_nuscenes_of_imported_labels_is_what_was_published_byte_for_byte(pair: Pair, tmp_path: Path) -> None:
    out = tmp_path / "again"
    out.mkdir()
    write_nuscenes(pair.imported, out, unheard)
    assert files_of(out) == files_of(pair.published.folder)


def test_sweeps_come_back_bit_for_bit(pair: Pair) -> None:
    for index in range(len(pair.recorded.sequence.frames)):
        ours, theirs = pair.recorded.samples.lidar(index), pair.imported.samples.lidar(index)
        assert np.array_equal(ours.points_lidar, theirs.points_lidar)
        assert np.array_equal(ours.intensity, theirs.intensity)
        assert np.array_equal(ours.ring, theirs.ring)


def test_pictures_come_back_as_they_are_at_their_microsecond(pair: Pair) -> None:
    for mount in pair.recorded.sequence.calibration.of_kind("camera"):
        for index in range(len(pair.recorded.sequence.frames)):
            ours, theirs = (one.samples.camera(mount.name, index) for one in (pair.recorded, pair.imported))
            assert (ours is None) == (theirs is None)
            if ours is not None and theirs is not None:
                assert ours.content == theirs.content
                assert (ours.width_px, ours.height_px) == (theirs.width_px, theirs.height_px)
                assert theirs.stamp_ns == ours.stamp_ns // 1000 * 1000


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
    source = altered(pair.published.folder, tmp_path, (b" vx vy ", b" ax ay "), ".pcd")
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


def test_mcap_has_the_same_messages_of_every_topic_at_their_microseconds(pair: Pair, tmp_path: Path) -> None:
    recorded, again = (stamps_us(out) for out in both(pair, write_foxglove, tmp_path))
    assert recorded == again


def test_playback_has_the_same_clouds_and_pictures(pair: Pair, tmp_path: Path) -> None:
    recorded, again = (files_of(out) for out in both(pair, write_playback, tmp_path))
    assert recorded == again


@pytest.mark.parametrize("form", ["rrd", "previews", "mesh"])
def test_other_formats_have_the_same_files(pair: Pair, tmp_path: Path, form: str) -> None:
    recorded, again = (files_of(out) for out in both(pair, EXPORTERS[form], tmp_path))
    assert recorded.keys() == again.keys()
    assert all(again.values())


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
    source = planted_source(pair.published.folder, tmp_path, planted.decode())
    out = tmp_path / "inputs"
    out.mkdir()
    write_inputs(replace(pair.imported, samples=DatasetSamples(source, pair.imported.sequence)), out, unheard)
    files = files_of(out)
    assert {name.split("/")[0] for name in files} == {"v1.0-trainval", "samples", "maps"}
    assert not any(planted in content or planted in name.encode() for name, content in files.items())
    assert json.loads(files["v1.0-trainval/sample_annotation.json"]) == []
    assert json.loads(files["v1.0-trainval/instance.json"]) == []
    (mask,) = (content for name, content in files.items() if name.startswith("maps/"))
    assert mask not in set(files_of(pair.published.folder).values())


def test_samples_can_be_given_to_another_process(pair: Pair) -> None:
    again = pickle.loads(pickle.dumps(DatasetSamples(pair.published.source, pair.imported.sequence)))
    assert np.array_equal(again.lidar(0).points_lidar, pair.imported.samples.lidar(0).points_lidar)


def test_a_file_that_the_tables_name_and_the_packs_lack_is_refused(pair: Pair, tmp_path: Path) -> None:
    source = altered(pair.published.folder, tmp_path, (b"__LIDAR_TOP__", b"__LIDAR_GONE__"), "sample_data.json")
    samples = DatasetSamples(source, pair.imported.sequence)
    with pytest.raises(DamagedExportError, match="which is not there"):
        samples.lidar(0)


def test_a_frame_that_has_no_sweep_is_refused(pair: Pair, tmp_path: Path) -> None:
    source = altered(pair.published.folder, tmp_path, (b'"is_key_frame":true', b'"is_key_frame":false'), ".json")
    with pytest.raises(DamagedExportError, match="frame 3 has no sweep of LIDAR_TOP"):
        DatasetSamples(source, pair.imported.sequence).lidar(3)


def altered(folder: Path, root: Path, change: tuple[bytes, bytes], ending: str) -> object:
    """The source with something said otherwise in the files of this ending."""
    for name, content in files_of(folder).items():
        if not name.startswith("gts/"):
            path = root / "altered" / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content.replace(*change) if name.endswith(ending) else content)
    return packed_source(root / "altered", root / "packed")


def planted_source(folder: Path, root: Path, planted: str) -> object:
    """The source with what could tell of labels in tables, in files of its own and in rows of those that are read."""
    tables = {"sample_annotation": [{"token": planted}], "lidarseg": [{"token": planted, "filename": planted}]}
    for name, rows in tables.items():
        (folder.parent / "planted" / "v1.0-trainval").mkdir(parents=True, exist_ok=True)
        (folder.parent / "planted" / "v1.0-trainval" / f"{name}.json").write_text(json.dumps(rows))
    for name, content in files_of(folder).items():
        path = folder.parent / "planted" / name
        if name.startswith("gts/") or path.exists():
            continue
        path.parent.mkdir(parents=True, exist_ok=True)
        said = content.replace(b'{"token":', b'{"drivable":"%s","token":' % planted.encode())
        path.write_bytes(said if name.endswith(".json") else content)
    (folder.parent / "planted" / "lidarseg").mkdir()
    (folder.parent / "planted" / "lidarseg" / "0.bin").write_text(planted)
    return packed_source(folder.parent / "planted", root / "packed")


def stamps_us(out: Path) -> dict[str, list[int]]:
    """The log times of each topic, in whole microseconds."""
    (path,) = out.glob("*.mcap")
    found = dict[str, list[int]]()
    with path.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages():
            found.setdefault(channel.topic, []).append(message.log_time // 1000)
    return found
