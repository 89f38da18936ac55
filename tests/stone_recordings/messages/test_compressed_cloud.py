"""Compressed clouds are the clouds that were compressed, and cost no more than they declare."""

import gzip
import zlib
from functools import partial

import numpy as np
import pytest
import zstandard

from stone.errors import StoneError
from stone_recordings.bags.errors import MessageLayoutError
from stone_recordings.messages.batch import StampedMessage
from stone_recordings.messages.pointcloud2 import decode_cloud
from stone_recordings.messages.radars.radar import decode_radar
from stone_recordings.messages.sweep_clouds import points_declared, points_problem, sweep_cloud, sweep_problem
from stone_recordings.sync.recorded_messages import OwnMessage
from testing.worlds.field.drive import FieldDrive
from testing.worlds.field.point_messages import COMPRESSED, COMPRESSED_FIELDS, compressed_message

DRIVE = FieldDrive(definitions=((COMPRESSED, COMPRESSED_FIELDS),))
PLAIN = DRIVE.velodyne(0.0)


def message(packer: str = "zlib", **other: object) -> memoryview:
    made = compressed_message(DRIVE, 0.0, packer)
    for name, value in other.items():
        setattr(made, name, value)
    return memoryview(DRIVE.store.serialize_cdr(made, COMPRESSED))


@pytest.mark.parametrize("packer", ["zlib", "zlib with its own header", "zstd"])
def test_a_compressed_cloud_is_the_cloud_that_was_compressed(packer: str) -> None:
    payload = message(packer)
    raw = memoryview(DRIVE.store.serialize_cdr(PLAIN, "sensor_msgs/msg/PointCloud2"))
    found, expected = sweep_cloud(payload, COMPRESSED), decode_cloud(raw)
    assert (found.stamp_ns, found.frame_id) == (expected.stamp_ns, expected.frame_id)
    assert found.points.dtype == expected.points.dtype
    assert found.points.tobytes() == expected.points.tobytes()
    assert points_declared(payload[:256], COMPRESSED) == len(expected.points)
    assert sweep_problem(payload, COMPRESSED) == ""
    for head in (payload, payload[:8192]):
        assert points_problem(head, COMPRESSED, lambda: len(payload)) == ""
    scan: StampedMessage = OwnMessage(payload)
    assert decode_radar(COMPRESSED, [scan]).counts.tolist() == [len(expected.points)]


@pytest.mark.parametrize("name", ["draco", "cloudini", "", "x" * 300])
def test_a_format_that_is_not_read_is_named_with_a_way_out(name: str) -> None:
    with pytest.raises(StoneError, match="republish") as refused:
        sweep_cloud(message("draco", format=name), COMPRESSED)
    assert refused.value.code == "MSG-330"
    assert repr(name[:40]) in str(refused.value)


@pytest.mark.parametrize("pack", [gzip.compress, zlib.compress, zstandard.compress])
def test_no_more_is_inflated_than_the_cloud_declares(pack: object) -> None:
    assert callable(pack)
    bomb = np.frombuffer(pack(bytes(len(PLAIN.data) + 1)), np.uint8)
    word = "zstd" if pack is zstandard.compress else "zlib"
    with pytest.raises(MessageLayoutError, match="more than the"):
        sweep_cloud(message(word, compressed_data=bomb), COMPRESSED)


@pytest.mark.parametrize("packer", ["zlib", "zstd"])
def test_a_cloud_that_does_not_inflate_is_refused_by_its_head_or_whole(packer: str) -> None:
    data = compressed_message(DRIVE, 0.0, packer).compressed_data
    for broken in (data[: len(data) // 2], data[4:], data[:0], np.zeros(50, np.uint8)):
        payload = message(packer, compressed_data=broken)
        with pytest.raises(StoneError):
            sweep_cloud(payload, COMPRESSED)
        assert points_problem(payload, COMPRESSED, partial(len, payload)) != ""
    payload = message(packer)
    assert "ends at byte" in points_problem(payload[:8192], COMPRESSED, lambda: len(payload) // 2)
