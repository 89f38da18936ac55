"""ROS 2 messages of one fixed layout, written as numpy records: a whole topic is one array assignment.

**Conventions.** XCDR1, little endian: four bytes of encapsulation, then every primitive aligned to its own size
counted from the end of those four bytes (OMG DDS-XTypes 1.3, 7.4.1). Strings are constants of the layout, so all
offsets are constants too. A message whose last part varies (a cloud, a JPEG) is `head + data + tail`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

ENCAPSULATION_BYTES = 4
CDR_LITTLE_ENDIAN = 0x0100  # bytes 00 01 00 00


@dataclass(frozen=True)
class CdrMember:
    """One primitive, fixed array or array of `stride`-padded structs; `default` fills every new record."""

    name: str
    dtype: DTypeLike
    default: object = 0


@dataclass(frozen=True)
class CdrText:
    """A string that is the same in every message of the layout."""

    name: str
    value: str


@dataclass(frozen=True, eq=False)
class CdrLayout:
    """The record type of one message kind and a template with all constants."""

    dtype: np.dtype[np.void]
    template: bytes

    def records(self, count: int) -> NDArray[np.void]:
        """Return `count` messages (count,) with their constants; a row's `tobytes()` is the whole CDR message."""
        return tiled(self.template, count, self.dtype)


def tiled(template: bytes, count: int, dtype: np.dtype[np.void]) -> NDArray[np.void]:
    """Return records repeated byte by byte, because numpy's own copies leave the bytes between fields undefined."""
    return np.frombuffer(bytearray(template * count), dtype)


def header(frame_id: str) -> tuple[CdrMember | CdrText, ...]:
    """Return the members of std_msgs/Header, with fields `sec`, `nanosec`."""
    return (CdrMember("sec", "<i4"), CdrMember("nanosec", "<u4"), CdrText("frame_id", frame_id))


def sequence_length(name: str, length: int = 0) -> CdrMember:
    return CdrMember(name, "<u4", length)


def layout(members: Sequence[CdrMember | CdrText]) -> CdrLayout:
    """Return the layout with offsets by the alignment rule; the record ends after the last member."""
    names, offsets, defaults = ["encapsulation"], [0], [np.array(CDR_LITTLE_ENDIAN)]
    formats: list[np.dtype[Any]] = [np.dtype("<u4")]
    end = ENCAPSULATION_BYTES
    for member in _expanded(members):
        dtype = np.dtype(member.dtype)
        size = _alignment(dtype)
        start = end + (ENCAPSULATION_BYTES - end) % size
        names.append(member.name)
        formats.append(dtype)
        offsets.append(start)
        defaults.append(np.asarray(member.default))
        end = start + dtype.itemsize
    spec = {"names": names, "formats": formats, "offsets": offsets, "itemsize": end}
    record = np.dtype(spec)  # type: ignore[call-overload]
    template = np.zeros(1, record)
    for name, default in zip(names, defaults, strict=True):
        template[name] = default
    return CdrLayout(record, template.tobytes())


def _expanded(members: Sequence[CdrMember | CdrText]) -> list[CdrMember]:
    flat: list[CdrMember] = []
    for member in members:
        if isinstance(member, CdrMember):
            flat.append(member)
            continue
        text = member.value.encode() + b"\0"
        flat.append(CdrMember(f"{member.name}_length", "<u4", len(text)))
        flat.append(CdrMember(member.name, f"S{len(text)}", text))
    return flat


def _alignment(dtype: np.dtype[np.generic]) -> int:
    base = dtype.base
    if base.fields is not None:
        return _alignment(base[0])
    return 1 if base.kind in "SV" else base.itemsize


def stamp_parts(stamps_ns: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return integer nanoseconds as builtin_interfaces/Time: (sec, nanosec)."""
    sec, nanosec = np.divmod(stamps_ns, 1_000_000_000)
    return sec, nanosec
