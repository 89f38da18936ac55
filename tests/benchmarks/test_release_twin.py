"""The full-size twin of the release: how its scenes are divided, and a ZIP of more files than 16 bits count."""

import zipfile
from collections import Counter
from pathlib import Path

from benchmarks.release_twin.__main__ import twin_of
from benchmarks.release_twin.way import TwinSplits, splits_of
from testing.worlds.zip_stream import zip_stream


def test_parts_are_whole_drives_and_test_has_a_place_of_its_own() -> None:
    twin = twin_of(279, 200, "release")
    places = Counter(twin.tables.location(scene) for scene in range(279))
    assert splits_of(twin) == TwinSplits(train=279 - 9 - places[twin.tables.location(278)], val=9, test=9)


def test_places_of_279_scenes_lie_within_what_is_mapped() -> None:
    twin = twin_of(279, 200, "release")
    assert len(twin.tables.places) == 4
    assert twin.apart_m * len(twin.tables.places) < 100_000


def test_a_zip_of_more_members_than_16_bits_count_is_read_by_others(tmp_path: Path) -> None:
    with zip_stream(tmp_path / "many.zip", is_deflated=True) as archive:
        archive.add_pieces("table.json", (b"[", b"1", b"]"))
        for number in range(66_000):
            archive.add(f"{number:05}", b"same")
    with zipfile.ZipFile(tmp_path / "many.zip") as found:
        assert len(found.namelist()) == 66_001
        assert (found.read("table.json"), found.read("65999")) == (b"[1]", b"same")
