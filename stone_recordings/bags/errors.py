"""Refusals of a recording or a message: one code per reason, one sentence each.

**Conventions.** `BAG-*` is about the container, `MSG-*` about one message in it. Offsets are bytes from the start of
the file unless the sentence names a chunk.
"""

from stone.errors import PlatformFaultError, Refused

SHOWN_BYTES = 16


class IngestError(Refused):
    """A recording cannot be used unchanged."""


class NotABagError(IngestError):
    """The file is not a recording: its first bytes belong to another format."""

    def __init__(self, name: str, first: bytes, looks_like: str) -> None:
        shown = first[:SHOWN_BYTES]
        text = "".join(chr(byte) if 32 <= byte < 127 else "." for byte in shown)
        quoted = f'first bytes {shown.hex(" ")} "{text}"' if shown else "no bytes at all"
        super().__init__(
            "BAG-001", f"{name} is not an MCAP, SQLite or ROS 1 bag ({quoted}); it looks like {looks_like}"
        )


class CutBagError(IngestError):
    """The file ends before its closing magic, or before its first message."""

    def __init__(self, name: str, size_bytes: int, missing: str = "the closing MCAP magic is missing") -> None:
        super().__init__(
            "BAG-010",
            f"{name} was cut off at byte {size_bytes}: {missing}; "
            f"the recorder died or the copy is incomplete, so copy it again, "
            f"or recover its intact part: stone recover {name} -o recovered.mcap",
        )


class MalformedBagError(IngestError):
    """A length, offset or value in the container contradicts the file."""

    def __init__(self, where: str, problem: str) -> None:
        super().__init__(
            "BAG-012",
            f"{where}: {problem}; the file is damaged or was not written by a working recorder, "
            "stone recover writes its intact part to another file",
        )


def encoding_refused(name: str, topic: str, encoding: str) -> IngestError:
    return IngestError(
        "BAG-014",
        f"{name}: topic {topic!r} is encoded as {encoding!r}, only 'cdr' is read; "
        f"protobuf and JSON recordings must be converted to ROS 2 first",
    )


class ChecksumError(IngestError):
    """A checksum does not match: the bytes differ from the recorded ones."""

    def __init__(self, where: str, found: int, declared: int) -> None:
        super().__init__(
            "BAG-016",
            f"{where}: CRC-32 is {found:08x}, declared {declared:08x}; the file was damaged after recording, "
            "stone recover writes its intact part to another file",
        )


class DefinitionMissingError(IngestError):
    """There is no known definition of a message type."""

    def __init__(self, type_name: str, known: tuple[str, ...]) -> None:
        super().__init__(
            "BAG-020",
            f"no definition of {type_name!r} is known (beside ROS 2 Humble's: {', '.join(known)}); "
            f"record with -s mcap, which embeds it",
        )


class MessageLayoutError(IngestError):
    """The lengths inside one CDR message contradict its type or its size."""

    def __init__(self, type_name: str, problem: str) -> None:
        super().__init__("MSG-301", f"{type_name}: {problem}; the message is damaged or of another version of its type")


class ByteOrderError(IngestError):
    """A message is serialised big-endian, which no current recorder writes."""

    def __init__(self, type_name: str) -> None:
        super().__init__(
            "MSG-302", f"{type_name} is big-endian; only little-endian data is read, so convert the recording"
        )


class CloudLayoutError(IngestError):
    """The fields, steps or sizes of a PointCloud2 contradict each other."""

    def __init__(self, problem: str) -> None:
        super().__init__("MSG-303", f"sensor_msgs/msg/PointCloud2: {problem}; the driver declares a wrong layout")


class PoseValueError(IngestError):
    """An invalid pose: NaN, infinity, or a quaternion of zero norm."""

    def __init__(self, type_name: str, index: int, problem: str) -> None:
        super().__init__("MSG-305", f"{type_name} number {index} {problem}; initialise the source before recording")


def database_refused(name: str, reason: str) -> IngestError:
    quoted = " ".join(reason.split())
    return IngestError("BAG-018", f"{name} cannot be read as a rosbag2 database: {quoted}")


def packed_too_large(where: str, packed_bytes: int, limit_bytes: int) -> IngestError:
    return IngestError(
        "BAG-027",
        f"{where}: its {packed_bytes} compressed bytes decompress to more than {limit_bytes}; "
        f"if that is its true size, decompress the file before uploading it",
    )


class NoRoomError(PlatformFaultError, IngestError):
    """A copy that must be decompressed to be read does not fit the folder for temporary files."""

    def __init__(self, name: str, size_bytes: int, free_bytes: int) -> None:
        super().__init__(
            "BAG-028",
            f"{name} needs a temporary copy of {size_bytes} bytes, {free_bytes} are free; set TMPDIR to a larger disk",
        )
