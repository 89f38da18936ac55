"""Definitions from strangers are read strictly, bounded, or refused by code."""

import time
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import get_types_from_msg

from stone_recordings.bags.errors import DefinitionMissingError
from stone_recordings.messages.errors import DefinitionRefusedError
from stone_recordings.messages.types.definition import MOST_CHARACTERS, MOST_ELEMENTS, MOST_FIELDS, Field, parsed
from stone_recordings.messages.types.plan import MOST_DEPTH, MOST_FIXED_BYTES, MOST_NODES
from stone_recordings.messages.types.registry import (
    MOST_UPLOADS,
    PACKAGES,
    MessageText,
    Registry,
    message_definition,
    registry,
    resolved,
    typestore,
)

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
    "no type": ("float64", r"'float64' is neither a field nor a constant"),
    "a name that is none": ("float64 1x", r"is neither a field nor a constant"),
    "a tail": ("int32 x y", r"'int32 x y' is neither a field nor a constant"),
    "a path": ("../../etc/passwd x", r"is neither a field nor a constant"),
    "a path of three": ("a/b/c x", r"'a/b/c' is not the name of a type"),
    "a capital package": ("Std/Header x", r"'Std/Header' is not the name of a type"),
    "two of a name": ("int32 x\nint64 x", r"field 'x' is declared twice"),
    "an array of nothing": ("int32[0] x", r"'x' has 0 elements, 1 to 1048576 are read"),
    "an array of millions": (f"int32[{MOST_ELEMENTS + 1}] x", r"has 1048577 elements"),
    "an endless number": ("int32[99999999999999999999] x", r"is neither a field nor a constant"),
    "a bound on a number": ("int32<=4 x", r"bounds a type that is not a string"),
    "a type of nobody": ("Other x", r"my_msgs/msg/Other is used and not defined"),
    "itself": ("Thing[] more", r"my_msgs/msg/Thing contains itself"),
    "a wide string": ("wstring x", r"x is a wstring, which has no agreed form on the wire"),
    "more fields than anyone has": ("\n".join(f"int8 f{n}" for n in range(MOST_FIELDS + 1)), r"the limit is 1024"),
    "more text than anyone has": ("#" * (MOST_CHARACTERS + 1), rf"has {MOST_CHARACTERS + 1} characters"),
    "another language": (f"int32 x\n{SEPARATOR}\nIDL: my_msgs/Other\nmodule", r"'MSG: …' is expected"),
    "one type twice": (f"int32 x\n{SEPARATOR}\nMSG: my_msgs/Thing\nint64 x", r"is defined twice, differently"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_definition_that_is_none_is_refused(case: str) -> None:
    text, sentence = REFUSED[case]
    with pytest.raises(DefinitionRefusedError, match=sentence) as caught:
        _registered(text)
    assert caught.value.code == "MSG-307"


@pytest.mark.parametrize("name", ["Thing", "my_msgs/srv/Thing", "my_msgs/msg/../Thing", "", "a" * 5000, "My/Thing"])
def test_a_bad_name_of_a_type_is_refused(name: str) -> None:
    with pytest.raises(DefinitionRefusedError, match="is not the name of a type"):
        registry((MessageText(name, "int32 x"),))


def _chain(length: int, repeat: str) -> tuple[MessageText, ...]:
    """my_msgs/T0 holds T1, which holds T2, …"""
    texts = [MessageText(f"my_msgs/msg/T{n}", f"T{n + 1}{repeat} next") for n in range(length)]
    return (*texts, MessageText(f"my_msgs/msg/T{length}", "uint8 x"))


def test_definitions_that_multiply_are_refused_at_once() -> None:
    """Each type holds the next ten times: 10^20 values, and as many bytes, in 22 short files."""
    before = time.process_time()
    tens = [MessageText(f"my_msgs/msg/T{n}", "\n".join(f"T{n + 1} f{m}" for m in range(10))) for n in range(20)] + [
        MessageText("my_msgs/msg/T20", "uint8 x")
    ]
    with pytest.raises(DefinitionRefusedError, match=rf"has more than {MOST_NODES} values"):
        registry(tens)
    with pytest.raises(DefinitionRefusedError, match=rf"takes at least 10+ bytes, {MOST_FIXED_BYTES} are read"):
        registry(_chain(20, "[10]"))
    with pytest.raises(DefinitionRefusedError, match=rf"is nested deeper than {MOST_DEPTH}"):
        registry(_chain(30, "[]"))
    assert time.process_time() - before < 2


def test_a_cycle_of_several_types_is_refused() -> None:
    ring = [MessageText(f"my_msgs/msg/{a}", f"{b}[] x") for a, b in ("AB", "BC", "CA")]
    with pytest.raises(DefinitionRefusedError, match=r"my_msgs/msg/A contains itself"):
        registry(ring)


@settings(max_examples=200, deadline=None)
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


def test_files_that_are_no_definitions_are_refused(tmp_path: Path) -> None:
    folder = tmp_path / "my_msgs" / "msg"
    folder.mkdir(parents=True)
    for name, content, sentence in (
        ("Thing.txt", b"int32 x", r"it is not a .msg file"),
        ("Thing.msg", b"\xff\xfe", r"it is not UTF-8 text"),
        ("Large.msg", b"#" * (MOST_CHARACTERS + 1), r"larger than 262144 bytes"),
        ("9.msg", b"int32 x", r"'my_msgs/9' is not the name of a type"),
    ):
        (folder / name).write_bytes(content)
        with pytest.raises(DefinitionRefusedError, match=sentence):
            registry((folder / name,))


def test_more_uploads_than_any_package_has_are_refused() -> None:
    with pytest.raises(DefinitionRefusedError, match=rf"at most {MOST_UPLOADS} are read"):
        registry([MessageText(f"my_msgs/msg/T{n}", "int32 x") for n in range(MOST_UPLOADS + 1)])
    with pytest.raises(DefinitionRefusedError, match=r"have more than \d+ characters together"):
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


def test_a_recording_without_definitions_is_read_by_what_is_known() -> None:
    assert resolved("nebula_msgs/msg/NebulaPackets", "").findings == ()
    with pytest.raises(DefinitionMissingError, match=r"no definition of 'my_msgs/msg/Thing' is known"):
        resolved(NAME, "")


def test_an_embedded_definition_in_another_language_leaves_what_is_known() -> None:
    idl = "module sensor_msgs { module msg { struct Imu { double x; }; }; };"
    found = resolved("sensor_msgs/msg/Imu", idl)
    assert found.registry is registry()
    assert [finding.code for finding in found.findings] == ["MSG-310"]
    with pytest.raises(DefinitionRefusedError, match=r"is neither a field nor a constant"):
        resolved(NAME, idl)


def test_every_package_that_is_ours_is_described_in_its_readme() -> None:
    folder = Path(__file__).parents[3] / "stone_recordings" / "messages" / "types" / "definitions"
    text = (folder / "README.md").read_text()
    assert {path.name for path in folder.iterdir() if path.is_dir()} == set(PACKAGES)
    for package in PACKAGES:
        assert f"`{package}`" in text
        for file in (folder / package / "msg").iterdir():
            assert not any(sign in file.read_text() for sign in "#="), f"{file} is more than a list of fields"
