"""An inspection with its outlook reads a recording once, and says what two passes over it say."""

from collections import Counter
from pathlib import Path

import pytest

from services.ingest.outlook import inspected_in
from simulator.options import SimulateOptions
from simulator.pipeline import simulate
from stone_recordings.bags import chunked_store
from stone_recordings.bags.bag import open_bag
from stone_recordings.bags.chunks import Chunk, inflate
from stone_recordings.report.inspection import scanned
from stone_recordings.topics.sources import AskedTopics
from testing.worlds.faults.catalogue import FAULTS
from testing.worlds.faults.drive import SoundDrive, faulty, simulated_drive

BY_NAME = {fault.name: fault for fault in FAULTS}
NAMES = (
    "one pose message garbage",
    "one cloud cut",
    "one sweep stamped 1 s back",
    "one picture garbage",
    "a zstd chunk with a bad CRC",
    "a cycle in tf_static",
    "tf_static cut",
)


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> SoundDrive:
    return simulated_drive(tmp_path_factory.mktemp("simulated"))


@pytest.mark.parametrize("name", NAMES)
def test_one_pass_says_what_two_say(simulated: SoundDrive, tmp_path: Path, name: str) -> None:
    bag = faulty(simulated, BY_NAME[name], tmp_path / "run.mcap")
    with open_bag(bag) as opened:
        one = inspected_in(opened)
    with open_bag(bag) as opened:
        alone = scanned(opened)
        assert alone.recorded is None
        two = inspected_in(opened, scan=alone)
    assert one.as_record() == two.as_record()


def test_every_chunk_is_inflated_once_but_those_of_clouds_that_are_looked_at(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = tmp_path / "run.mcap"
    simulate(bag, SimulateOptions(seconds=5.0, channels=64, columns=720, cameras=False))
    times = Counter[int]()

    def counted(view: memoryview, chunk: Chunk) -> memoryview:
        times[chunk.start] += 1
        return inflate(view, chunk)

    monkeypatch.setattr(chunked_store, "inflate", counted)
    with open_bag(bag) as opened:
        inspected_in(opened)
    again = sum(count > 1 for count in times.values())
    assert len(times) > 15
    assert again <= len(times) / 3, times


def test_topics_that_synchronisation_would_refuse_are_scanned_without_it(simulated: SoundDrive) -> None:
    with open_bag(simulated.bag) as bag:
        found = scanned(bag, AskedTopics(lidar="/nothing"))
        assert found.recorded is None
        assert found.stamps_ns.keys() == scanned(bag, AskedTopics()).stamps_ns.keys()
        assert scanned(bag, AskedTopics()).recorded is not None
