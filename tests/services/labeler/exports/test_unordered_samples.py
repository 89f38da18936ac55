"""Inputs without order: no file has a stamp, a pose or the order of the drive; each sample belongs to its frame."""

import io
import json

import numpy as np
import pytest
from PIL import Image

from services.domain.benchmarks.phases.unordered_frames import UnorderedFrames
from services.labeler.exports.nuscenes.samples import lidar_bytes
from services.labeler.exports.sandboxed_export import write_sensed
from services.labeler.exports.unordered_samples import bare_jpeg, without_order
from tests.services.labeler.exports.made import Labelled, files_of, unheard

CHOICE = UnorderedFrames(2, "5c" * 32)


@pytest.fixture(scope="module")
def files(drive: Labelled, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    source, folder = drive.source(), tmp_path_factory.mktemp("unordered")
    chosen = without_order(source.sequence, source.samples, CHOICE.of(source.sequence.frames.tokens))
    write_sensed(*chosen, folder, unheard, is_ordered=False)
    return files_of(folder)


def table(files: dict[str, bytes], name: str) -> list[dict[str, object]]:
    rows: list[dict[str, object]] = json.loads(files[f"v1.0-trainval/{name}.json"])
    return rows


def test_no_file_has_a_stamp_a_token_or_an_origin_of_the_drive(drive: Labelled, files: dict[str, bytes]) -> None:
    sequence = drive.source().sequence
    known = [*sequence.frames.tokens, *sequence.inputs, *(str(ns // 1000) for ns in sequence.frames.stamps_ns.tolist())]
    known += [str(ns // 1000)[:8] for ns in sequence.frames.stamps_ns.tolist()]  # the same hundred seconds
    names_and_bytes = "\n".join(files).encode() + b"".join(files.values())
    assert [one for one in known if one.encode() in names_and_bytes] == []
    (log,) = table(files, "log")
    assert (log["date_captured"], log["map_origin_deg_m"], log["pose_source"]) == ("1970-01-01", None, "none")


def test_every_pose_is_the_same_and_no_frame_has_a_neighbour(files: dict[str, bytes]) -> None:
    poses = {json.dumps([row["translation"], row["rotation"]]) for row in table(files, "ego_pose")}
    assert len(poses) == 1
    for row in (*table(files, "sample"), *table(files, "sample_data")):
        assert (row["prev"], row["next"]) == ("", "")
    stamps = {row["sample_token"]: row["timestamp"] for row in table(files, "sample_data")}
    for row in (*table(files, "sample_data"), *table(files, "sample")):
        assert row["timestamp"] == stamps[row.get("sample_token", row["token"])]


def test_frames_are_every_second_one_in_an_order_of_their_own(drive: Labelled, files: dict[str, bytes]) -> None:
    tokens = drive.source().sequence.frames.tokens
    chosen = CHOICE.of(tokens)
    assert [row["token"] for row in table(files, "sample")] == [token for token, _ in chosen] == sorted(dict(chosen))
    assert sorted(place for _, place in chosen) == list(range(0, len(tokens), 2))
    orders = [[place for _, place in UnorderedFrames(1, f"{key:064x}").of(tokens)] for key in range(20)]
    assert len({tuple(order) for order in orders}) == 20
    assert {place for order in orders for place in order[:1]} != {0}


def test_a_sweep_is_that_of_its_frame(drive: Labelled, files: dict[str, bytes]) -> None:
    samples, chosen = drive.source().samples, dict(CHOICE.of(drive.source().sequence.frames.tokens))
    found = {row["sample_token"]: row["filename"] for row in table(files, "sample_data") if "LIDAR" in row["filename"]}
    assert found.keys() == chosen.keys()
    for token, place in chosen.items():
        assert files[str(found[token])] == lidar_bytes(samples.lidar(place))
    pictures = [row for row in table(files, "sample_data") if row["fileformat"] == "jpg"]
    assert len(pictures) == 6 * len(chosen)


def test_a_picture_loses_what_is_written_beside_it() -> None:
    picture, file = Image.fromarray(np.arange(3072, dtype=np.uint8).reshape(32, 32, 3)), io.BytesIO()
    exif = Image.Exif()
    exif[0x0132] = "2026:11:28 12:00:00"
    picture.save(file, "JPEG", exif=exif, comment=b"frame 17 of the drive")
    content = file.getvalue() + b"stamp 1760000000"
    bare = bare_jpeg(content)
    assert b"2026:11:28" in content
    assert not any(word in bare for word in (b"2026:11:28", b"frame 17", b"1760000000", b"Exif"))
    with Image.open(io.BytesIO(bare)) as shown, Image.open(file) as recorded:
        assert (np.asarray(shown) == np.asarray(recorded)).all()
    for cut in range(len(content)):
        assert len(bare_jpeg(content[:cut])) <= cut


def test_a_phase_has_tokens_that_its_key_alone_makes() -> None:
    tokens = tuple(f"{n:032x}" for n in range(50))
    one, other = UnorderedFrames(1, "00" * 32).of(tokens), UnorderedFrames(1, "01" * 32).of(tokens)
    assert not {token for token, _ in one} & ({token for token, _ in other} | set(tokens))
    assert all(len(token) == 32 and int(token, 16) >= 0 for token, _ in one)
