"""Definitions from strangers are read strictly, bounded, or refused by code."""

import time
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import get_types_from_msg

from stone_recordings.bags.bag import Bag, open_bag
from stone_recordings.bags.errors import DefinitionMissingError
from stone_recordings.bags.message_store import Topic
from stone_recordings.messages.errors import DefinitionRefusedError
from stone_recordings.messages.types.definition import MOST_CHARACTERS, MOST_ELEMENTS, MOST_FIELDS, Field, parsed
from stone_recordings.messages.types.definition_checks import MOST_DEFINITIONS, definition_findings
from stone_recordings.messages.types.registry import (
    MOST_UPLOADS,
    MessageText,
    Registry,
    message_definition,
    registry,
    resolved,
    typestore,
)
from stone_recordings.messages.types.table import decode_table
from stone_recordings.report.inspection import inspect
from tests.stone_recordings.databases import write_db3
from tests.stone_recordings.writing import Recorded, write_mcap

NAME = "my_msgs/msg/Thing"
SEPARATOR = "=" * 80


def _registered(text: str, *more: MessageText) -> Registry:
    return registry((MessageText(NAME, text), *more))


def test_every_way_to_write_a_field_is_read() -> None:
    text = """
        # a comment
        Header header        # of ROS 1
        int32 KIND=3
        string NAME = "a # b"
        float64[9] matrix
        float32[] values
        uint8[<=10] bounded
        string<=20 short
        string<=20[<=3] many
        geometry_msgs/Point[2] points
        geometry_msgs/msg/Pose pose
        Other other
        int32 with_default 5
        string text "a = b"
        time stamp
        byte b
        char c
    """
    expected = {
        "header": ("std_msgs/msg/Header", "one", 0), "matrix": ("float64", "array", 9),
        "values": ("float32", "sequence", 0), "bounded": ("uint8", "sequence", 0), "short": ("string", "one", 0),
        "many": ("string", "sequence", 0), "points": ("geometry_msgs/msg/Point", "array", 2),
        "pose": ("geometry_msgs/msg/Pose", "one", 0), "other": ("my_msgs/msg/Other", "one", 0),
        "with_default": ("int32", "one", 0), "text": ("string", "one", 0),
        "stamp": ("builtin_interfaces/msg/Time", "one", 0), "b": ("byte", "one", 0), "c": ("char", "one", 0),
    }  # fmt: skip
    assert parsed(text, NAME) == {NAME: tuple(Field(name, *detail) for name, detail in expected.items())}


@pytest.mark.parametrize("type_name", sorted(typestore().fielddefs))
def test_a_definition_that_rosbags_writes_is_read_back(type_name: str) -> None:
    """Of every type that is built in, with all types in it."""
    text = message_definition(type_name)
    types = parsed(text, type_name)
    assert set(types) == set(get_types_from_msg(text, type_name))
    assert all(registry().types[name] == fields for name, fields in types.items())


REFUSED = {
    "no type": "float64", "a name that is none": "float64 1x", "a tail": "int32 x y", "a path": "../../etc/passwd x",
    "a path of three": "a/b/c x", "a capital package": "Std/Header x", "two of a name": "int32 x\nint64 x",
    "an array of nothing": "int32[0] x", "an array of millions": f"int32[{MOST_ELEMENTS + 1}] x",
    "an endless number": "int32[99999999999999999999] x", "a bound on a number": "int32<=4 x",
    "a type of nobody": "Other x", "itself": "Thing[] more", "a wide string": "wstring x",
    "more fields than anyone has": "\n".join(f"int8 f{n}" for n in range(MOST_FIELDS + 1)),
    "more text than anyone has": "#" * (MOST_CHARACTERS + 1),
    "another language": f"int32 x\n{SEPARATOR}\nIDL: my_msgs/Other\nmodule",
    "one type twice": f"int32 x\n{SEPARATOR}\nMSG: my_msgs/Thing\nint64 x",
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_a_definition_that_is_none_is_refused(case: str) -> None:
    with pytest.raises(DefinitionRefusedError) as caught:
        _registered(REFUSED[case])
    assert caught.value.code == "MSG-307"


@pytest.mark.parametrize("name", ["Thing", "my_msgs/srv/Thing", "my_msgs/msg/../Thing", "", "a" * 5000, "My/Thing"])
def test_a_bad_name_of_a_type_is_refused(name: str) -> None:
    with pytest.raises(DefinitionRefusedError):
        registry((MessageText(name, "int32 x"),))


def _chain(length: int, repeat: str) -> tuple[MessageText, ...]:
    """my_msgs/T0 holds T1, which holds T2, …"""
    texts = [MessageText(f"my_msgs/msg/T{n}", f"T{n + 1}{repeat} next") for n in range(length)]
    return (*texts, MessageText(f"my_msgs/msg/T{length}", "uint8 x"))


def test_definitions_that_multiply_or_lead_back_are_refused_at_once() -> None:
    """Each type holds the next ten times: 10^20 values, and as many bytes, in 22 short files."""
    before = time.process_time()
    tens = [MessageText(f"my_msgs/msg/T{n}", "\n".join(f"T{n + 1} f{m}" for m in range(10))) for n in range(20)] + [
        MessageText("my_msgs/msg/T20", "uint8 x")
    ]
    with pytest.raises(DefinitionRefusedError):
        registry(tens)
    with pytest.raises(DefinitionRefusedError):
        registry(_chain(20, "[10]"))
    with pytest.raises(DefinitionRefusedError):
        registry(_chain(30, "[]"))
    assert time.process_time() - before < 2
    ring = [MessageText(f"my_msgs/msg/{a}", f"{b}[] x") for a, b in ("AB", "BC", "CA")]
    with pytest.raises(DefinitionRefusedError):
        registry(ring)


@settings(max_examples=100)
@given(text=st.one_of(st.text(max_size=200), st.text("ab/[]<=9 =#\n\t1", max_size=200)))
def test_any_text_is_read_or_refused_by_code(text: str) -> None:
    code = "MSG-307"
    try:
        _registered(text)
    except DefinitionRefusedError as error:
        code = error.code
    assert code == "MSG-307"


def test_uploaded_files_add_to_what_is_known(tmp_path: Path) -> None:
    folder = tmp_path / "my_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Thing.msg").write_text("std_msgs/Header header\nOther[] others\n")
    (folder / "Other.msg").write_text("float32 x\n")
    known = registry((folder / "Thing.msg", folder / "Other.msg"))
    assert NAME in known
    assert NAME not in registry()
    assert [node.name for node in known.plan(NAME)][-1] == "others"
    assert "sensor_msgs/msg/Imu" in known


def test_files_that_are_no_definitions_or_too_many_are_refused(tmp_path: Path) -> None:
    folder = tmp_path / "my_msgs" / "msg"
    folder.mkdir(parents=True)
    files = {"Thing.txt": b"int32 x", "Thing.msg": b"\xff\xfe", "9.msg": b"int32 x"}
    for name, content in (files | {"Large.msg": b"#" * (MOST_CHARACTERS + 1)}).items():
        (folder / name).write_bytes(content)
        with pytest.raises(DefinitionRefusedError):
            registry((folder / name,))
    with pytest.raises(DefinitionRefusedError):
        registry([MessageText(f"my_msgs/msg/T{n}", "int32 x") for n in range(MOST_UPLOADS + 1)])
    with pytest.raises(DefinitionRefusedError):
        registry([MessageText(f"my_msgs/msg/T{n}", "#" * MOST_CHARACTERS) for n in range(5)])


def test_an_embedded_definition_wins_and_the_difference_is_said() -> None:
    """The ROS 1 line of NovAtel's driver, whose header ends two fields earlier."""
    type_name = "novatel_oem7_msgs/msg/INSPVA"
    same = message_definition(type_name)
    assert resolved(type_name, same).findings == ()
    older = same.replace("uint32 receiver_status\nfloat32 idle_time\n", "")
    found = resolved(type_name, older)
    (finding,) = found.findings
    assert (finding.code, finding.severity) == ("MSG-309", "warning")
    assert "Oem7Header has 7 fields, 9 are known" in finding.message
    assert len(found.registry.types["novatel_oem7_msgs/msg/Oem7Header"]) == 7
    moved = resolved(type_name, same.replace("float64 azimuth", "float32 azimuth"))
    assert "has 'float32 azimuth' where 'float64 azimuth' is known" in moved.findings[0].message


def test_without_a_definition_or_with_one_in_another_language_what_is_known_counts() -> None:
    assert resolved("nebula_msgs/msg/NebulaPackets", "").findings == ()
    with pytest.raises(DefinitionMissingError):
        resolved(NAME, "")
    idl = "module sensor_msgs { module msg { struct Imu { double x; }; }; };"
    found = resolved("sensor_msgs/msg/Imu", idl)
    assert found.registry is registry()
    assert [finding.code for finding in found.findings] == ["MSG-310"]
    with pytest.raises(DefinitionRefusedError):
        resolved(NAME, idl)


IMU = "sensor_msgs/msg/Imu"


@pytest.mark.parametrize(
    "topic",
    [
        Topic("/imu", "sensor_msgs/msg/Imu", 3, ""), Topic("/radar", "ars548_messages/msg/DetectionList", 3, ""),
        Topic("/own", "acme_msgs/msg/Thing", 3, "uint32 count\nstring name\n"),
        Topic("/own", "acme_msgs/msg/Thing", 0, ""), Topic("/pb", "acme.Thing", 5, "", "protobuf"),
    ],
)  # fmt: skip
def test_what_is_known_described_silent_or_of_another_encoding_needs_no_definition(topic: Topic) -> None:
    assert list(definition_findings([topic])) == []


def test_a_definition_that_is_missing_differs_or_is_none_is_said() -> None:
    (found,) = definition_findings([Topic("/imu", IMU, 3, ""), Topic("/own", "acme_msgs/msg/Thing", 3, "")])
    assert (found.code, found.severity, found.topic) == ("BAG-020", "warning", "/own")
    other = message_definition(IMU).replace("geometry_msgs/Vector3 angular_velocity", "float32[3] angular_velocity", 1)
    assert other != message_definition(IMU)
    (found,) = definition_findings([Topic("/imu", IMU, 3, other)])
    assert (found.code, found.topic) == ("MSG-309", "/imu")
    (found,) = definition_findings([Topic("/own", "acme_msgs/msg/Thing", 3, "this is { no definition")])
    assert (found.severity, found.topic) == ("warning", "/own")
    assert found.code.startswith("MSG-")


def test_of_endless_topics_the_first_are_looked_at_and_the_others_counted() -> None:
    topics = [Topic(f"/{row}", IMU, 1, "") for row in range(MOST_DEFINITIONS + 7)]
    (found,) = definition_findings(topics)
    assert (found.code, found.severity) == ("BAG-020", "info")
    assert "7 further topics" in found.message


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


@pytest.mark.parametrize("text", [b"uint8 a\xff", b"uint8 x\n" * 9000, b"Reading again\n"])
def test_a_definition_that_cannot_be_one_is_a_finding_and_changes_nothing(folder: Path, text: bytes) -> None:
    (folder / "field_msgs.Reading.msg").write_bytes(text)
    with open_bag(folder) as bag:
        refused = [finding.message for finding in bag.findings if finding.code == "MSG-307"]
        assert len(refused) == 1
        assert bag.topics[0].schema == ""
