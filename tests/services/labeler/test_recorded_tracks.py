"""Recordings of one run that was cut into files, each synchronised by itself, are one drive."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest

from services.ingest.pipeline import SynchroniseOptions
from services.ingest.sequence import open_sequence
from services.labeler.totals import recorded_track
from simulator.options import SimulateOptions
from simulator.pipeline import calibration_path, simulate, sweep_stamps_ns
from stone.splits.drives import DrivenTrack, drives_of
from testing.worlds.recording_parts import RecordingPart, split_into

DRIVE = SimulateOptions(seconds=9.0, seed=3, channels=8, columns=90, cameras=False, world_width_m=30.0)


@pytest.fixture(scope="module")
def tracks(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, DrivenTrack]:
    """Of three files of three seconds, each with an origin of its own."""
    folder = tmp_path_factory.mktemp("cut")
    source = folder / "run.mcap"
    simulate(source, DRIVE)
    begin_ns = sweep_stamps_ns(DRIVE)[0]
    cuts = [(f"part-{n}", begin_ns + 3 * n * 10**9) for n in range(3)]
    parts = [RecordingPart(f"{name}.mcap", between(at_ns, at_ns + 3 * 10**9)) for name, at_ns in cuts]
    found = dict[str, DrivenTrack]()
    for path in split_into(source, folder, parts):
        sequence, _ = open_sequence(path, calibration_path(source), path.stem, SynchroniseOptions(is_checked=False))
        answer = recorded_track(sequence)
        assert answer is not None
        found[path.stem] = DrivenTrack(**answer.model_dump())
    return found


def between(begin_ns: int, end_ns: int) -> Callable[[str, int], bool]:
    return lambda topic, time_ns: topic == "/tf_static" or begin_ns <= time_ns < end_ns


def test_files_of_one_run_are_one_drive_by_where_they_are_on_the_earth(tracks: Mapping[str, DrivenTrack]) -> None:
    assert set(drives_of(tracks).values()) == {("part-0", "part-1", "part-2")}
    assert {track.map for track in tracks.values()} == {"earth"}
    place_m = np.linalg.norm([place[1:] for track in tracks.values() for place in track.places], axis=1)
    assert (np.abs(place_m - 6.37e6) < 3e4).all(), "from the centre of the earth"
    without = {name: track for name, track in tracks.items() if name != "part-1"}
    assert len(set(drives_of(without).values())) == 1, "3 s are a short gap"


def test_a_file_of_another_robot_or_of_ten_metres_aside_is_not(tracks: Mapping[str, DrivenTrack]) -> None:
    first, second = tracks["part-0"], tracks["part-1"]
    aside = tuple((s, x, y + 10.0, z) for s, x, y, z in second.places)
    for other in (replace(second, vehicle="another"), replace(second, places=aside)):
        assert len(set(drives_of({"a": first, "b": other}).values())) == 2
