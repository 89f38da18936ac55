"""A recording is added to a labelled sequence, and the platform dies: what depends on it is made again all the same.

Catches alone a re-run that was only in a process' memory, one that is started twice, and one that nobody starts.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from simulator.options import SimulateOptions
from simulator.pipeline import calibration_path, simulate
from stone_client.api import Api
from stone_client.files.bags import hashed_bag
from stone_client.files.tus import Purpose, upload_file
from stone_client.server.job_following import follow
from stone_client.server.sequences import add_recording, ensure_sequence, find_sequence, pin_calibration, start_run
from testing.stone_serve import Serving, serving, until
from testing.worlds.recording_parts import RecordingPart, split_into

pytestmark = pytest.mark.whole

RUN = SimulateOptions(seconds=3.0, seed=3, channels=16, columns=180, cameras=False)
CUTS_NS = (1_749_718_802_000_000_000, 1_749_718_802_600_000_000)
PARTS = (
    RecordingPart("first.mcap", lambda _, ns: ns < CUTS_NS[0]),
    RecordingPart("second.mcap", lambda _, ns: CUTS_NS[0] <= ns < CUTS_NS[1]),
    RecordingPart("third.mcap", lambda _, ns: ns >= CUTS_NS[1]),
)


def quiet(_stage: str, _done: int, _total: int) -> None:
    """Nobody watches."""


def added_at_once(api: Api, sequence: Mapping[str, Any], *bags: Path) -> None:
    """Sent and sealed; nobody waits until they are read."""
    for bag in bags:
        (file,) = hashed_bag(bag, quiet).files
        upload_id = upload_file(api, file, Purpose("recording", sequence["id"]), quiet)
        api.create(f"/sequences/{sequence['id']}/recordings", {"upload_id": upload_id})


def is_labelled(platform: Serving, sequence: Mapping[str, Any], recordings: int) -> bool:
    """Whether the labels that count are of so many recordings."""
    with platform.api() as api:
        now = find_sequence(api, sequence["id"])
        if now["labels"] is None or now["later_recordings"] is not None or now["recordings"] != recordings:
            return False
        return len(api.read(f"/sequences/{sequence['id']}/report")["recordings"]) == recordings


def runs_of(platform: Serving, sequence: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    with platform.api() as api:
        return list(api.pages("/jobs", sequence_id=sequence["id"], kind="sequence.process"))


@pytest.mark.release
def test_recordings_that_come_later_are_labelled_once_though_the_platform_is_killed_three_times(tmp_path: Path) -> None:
    """Catches alone a recording that is lost or labelled twice if the platform is killed while it is joined."""
    simulate(tmp_path / "run.mcap", RUN)
    first, *later = split_into(tmp_path / "run.mcap", tmp_path, PARTS)
    with serving(tmp_path / "data") as platform:
        with platform.api() as api:
            sequence = ensure_sequence(api, "field")
            pin_calibration(api, sequence, calibration_path(tmp_path / "run.mcap"))
            add_recording(api, sequence, hashed_bag(first, quiet), quiet)
            follow(api, start_run(api, sequence, {"profile": "local"})["id"], quiet)
            added_at_once(api, sequence, *later)
        platform.kill_9()
    with serving(tmp_path / "data") as platform:
        with platform.api() as api:
            path = f"/sequences/{sequence['id']}/recordings"
            until(lambda: all(one["state"] == "registered" for one in api.pages(path)))
        platform.kill_9()
    with serving(tmp_path / "data") as platform:
        until(lambda: len(runs_of(platform, sequence)) == 2)
        platform.kill_9()
    with serving(tmp_path / "data") as platform:
        until(lambda: is_labelled(platform, sequence, 3))
        runs = runs_of(platform, sequence)
        with platform.api() as api:
            report = api.read(f"/sequences/{sequence['id']}/report")
    assert [run["state"] for run in runs] == ["succeeded"] * 2
    assert report["parameters"]["profile"] == "local"
    assert {one["name"]: one["offset_ns"] for one in report["recordings"]} == {part.name: 0 for part in PARTS}
