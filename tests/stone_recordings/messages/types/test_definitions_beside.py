"""Definitions beside a bag describe what its recorder did not; they are checked as everything from outside is."""

from pathlib import Path

import pytest

from stone_files.bag_files import BadBagFilesError, check_bag_files
from stone_recordings.bags.bag import Bag, open_bag
from stone_recordings.messages.types.registry import MessageText, registry, resolved
from stone_recordings.messages.types.table import decode_table
from stone_recordings.report.inspection import inspect
from tests.stone_recordings.databases import write_db3
from tests.stone_recordings.writing import Recorded, write_mcap

TYPE, STAMP_S = "field_msgs/msg/Reading", 1_700_000_000
READING = "std_msgs/Header header\nPart[2] parts\n"
PART = "uint16 number\nfloat32 value\n"
HEADER = STAMP_S.to_bytes(4, "little") + bytes(4) + (1).to_bytes(4, "little") + b"\0"


def payload(first: int) -> bytes:
    """A header with no frame, then two parts."""
    body = HEADER + b"\0" * 1
    for number in (first, first + 1):
        body += b"\0" * (-len(body) % 2) + number.to_bytes(2, "little")
        body += b"\0" * (-len(body) % 4) + b"\0\0\x80\x3f"
    return b"\0\1\0\0" + body


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    run = tmp_path / "run"
    run.mkdir()
    write_db3(run / "run_0.db3", [Recorded("/reading", TYPE, row, payload(row)) for row in range(5)], version=3)
    return run


def describe(folder: Path) -> None:
    (folder / "field_msgs.Reading.msg").write_text(READING)
    (folder / "field_msgs.Part.msg").write_text(PART)


def numbers(bag: Bag) -> list[list[int]]:
    topic = bag.topics[0]
    known = resolved(topic.type, topic.schema).registry
    table = decode_table(topic.type, bag.messages(topic.name), known)
    return [row.tolist() for row in table.numbers("parts.number", 2)]


def codes(folder: Path) -> set[str]:
    return {finding.code for finding in inspect(folder).findings}


def test_a_type_that_nobody_describes_is_read_by_the_definitions_beside_it(folder: Path) -> None:
    assert "BAG-020" in codes(folder)
    describe(folder)
    assert "BAG-020" not in codes(folder)
    with open_bag(folder) as bag:
        assert numbers(bag) == [[row, row + 1] for row in range(5)]
    timing = inspect(folder).topics[0].timing
    assert timing.has_header
    assert set(timing.stamps_ns.tolist()) == {STAMP_S * 10**9}


def test_what_the_recording_embeds_wins(tmp_path: Path) -> None:
    run = tmp_path / "run"
    run.mkdir()
    write_mcap(run / "run_0.mcap", [Recorded("/imu", "sensor_msgs/msg/Imu", 1, b"\0\1\0\0")])
    before = open_bag(run).topics
    (run / "sensor_msgs.Imu.msg").write_text("uint8 other\n")
    assert open_bag(run).topics == before


@pytest.mark.parametrize(
    ("text", "says"),
    [(b"uint8 a\xff", "UTF-8"), (b"uint8 x\n" * 9000, "larger than 65536"), (b"Reading again\n", "")],
)
def test_a_definition_that_cannot_be_one_is_a_finding_and_changes_nothing(folder: Path, text: bytes, says: str) -> None:
    (folder / "field_msgs.Reading.msg").write_bytes(text)
    with open_bag(folder) as bag:
        refused = [finding.message for finding in bag.findings if finding.code == "MSG-307"]
        assert len(refused) == 1
        assert says in refused[0]
        assert bag.topics[0].schema == ""


def test_definitions_are_parts_of_a_bag_but_no_bag() -> None:
    check_bag_files(["run_0.db3", "field_msgs.Reading.msg"])
    with pytest.raises(BadBagFilesError, match=r"no \.mcap, no \.db3 and no \.bag file"):
        check_bag_files(["field_msgs.Part.msg", "field_msgs.Reading.msg"])
    with pytest.raises(BadBagFilesError, match="is not part of a bag"):
        check_bag_files(["run_0.db3", "reading.msg"])


def test_the_definitions_are_those_that_the_registry_takes_as_files(folder: Path) -> None:
    describe(folder)
    texts = (MessageText(TYPE, READING), MessageText("field_msgs/msg/Part", PART))
    with open_bag(folder) as bag:
        by_schema = resolved(TYPE, bag.topics[0].schema).registry
    assert by_schema.plan(TYPE) == registry(texts).plan(TYPE)
