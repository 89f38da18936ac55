"""Packets of Hesai's Pandar40P and OT128 as returns.

**Conventions.** A block has an azimuth (hundredths of a degree) and a range for each laser; in modes with several
returns as many blocks follow each other with one azimuth. A packet's time is that of its end. An OT128 and a Pandar128
send the same packets; the OT128's angles are used. Firing times are those of standard resolution; in high resolution a
point is up to 28 µs off. Source: user manuals of Pandar40P (400-en-2211A10) and OT128; Nebula.
"""

import numpy as np
from numpy.typing import NDArray

from stone_recordings.messages.lidars.models import CONFIDENCE_FLAG, SAFETY_BYTES, SAFETY_FLAG
from stone_recordings.messages.lidars.points import (
    AZIMUTH_DEG,
    ELEVATION_DEG,
    OT128_FIRING_NS,
    PANDAR40P_FIRING_NS,
    PacketReturns,
    packet_times_ns,
    without_repeats,
)

SECOND_US = 1_000_000
TWO_RETURNS, THREE_RETURNS = (0x39, 0x3A, 0x3B, 0x3C, 0x3E), 0x3D
_RECORD = np.dtype([("range", "<u2"), ("intensity", "u1")])
_SURE_RECORD = np.dtype([("range", "<u2"), ("intensity", "u1"), ("confidence", "u1")])
_40P_BLOCK = np.dtype([("start", "<u2"), ("azimuth", "<u2"), ("returns", _RECORD, 40)])
_40P = np.dtype(
    [("blocks", _40P_BLOCK, 10), ("other", "u1", 10), ("time_us", "<u4"), ("mode", "u1"), ("factory", "u1"),
     ("date", "u1", 6)]
)  # fmt: skip
BLOCK_START = 0xEEFF
_40P_UNIT_M, _40P_CYCLE_NS, _40P_LAST_NS = 0.004, 55_560, 28_580
_OT128_CYCLE_NS, _OT128_BASE_NS = 55_556, 43_346


def pandar40p_returns(packets: list[memoryview], stamps_ns: NDArray[np.int64]) -> PacketReturns:
    """Return P packets, P > 0, as (P, groups, returns, lasers)."""
    raw = np.frombuffer(b"".join(packet[: _40P.itemsize] for packet in packets), _40P)
    echoes = _echoes(int(raw["mode"][0]), 10)
    sent_ns = packet_times_ns(raw["time_us"].astype(np.int64), SECOND_US, stamps_ns)
    is_whole = (raw["blocks"]["start"] == BLOCK_START) & (raw["mode"] == raw["mode"][0])[:, None]
    before = _40P_LAST_NS + _40P_CYCLE_NS * np.arange(10 // echoes)[::-1]
    fired_ns = sent_ns[:, None, None] - before[:, None] + PANDAR40P_FIRING_NS
    return _returns("Pandar40P", np.where(is_whole, _40P_UNIT_M, 0.0), raw["blocks"], fired_ns[:, :, None])


def ot128_returns(packets: list[memoryview], stamps_ns: NDArray[np.int64]) -> PacketReturns:
    """Return P packets of one layout, P > 0, as (P, groups, returns, lasers); packets of another size have no
    returns.
    """
    layout = ot128_layout(packets[0][11])
    raw = np.frombuffer(b"".join(packet[: layout.itemsize] for packet in packets), layout)
    echoes = _echoes(int(raw["mode"][0]), 2)
    sent_ns = packet_times_ns(raw["time_us"].astype(np.int64), SECOND_US, stamps_ns)
    before = _OT128_CYCLE_NS * np.arange(2 // echoes)[::-1] - _OT128_BASE_NS
    fired_ns = sent_ns[:, None, None] - before[:, None] + OT128_FIRING_NS
    unit_m = np.where(raw["mode"] == raw["mode"][0], raw["head"][:, 9] / 1000, 0.0)
    return _returns("OT128", np.broadcast_to(unit_m[:, None], (len(raw), 2)), raw["blocks"], fired_ns[:, :, None])


def ot128_layout(flags: int) -> np.dtype[np.void]:
    """Return the record of a packet whose header has these flags, up to the time."""
    record = _SURE_RECORD if flags & CONFIDENCE_FLAG else _RECORD
    block = np.dtype([("azimuth", "<u2"), ("returns", record, 128)])
    safety = [("safety", "u1", SAFETY_BYTES)] if flags & SAFETY_FLAG else []
    return np.dtype(
        [("head", "u1", 12), ("blocks", block, 2), ("crc", "<u4"), *safety, ("other", "u1", 12), ("mode", "u1"),
         ("motor", "<u2"), ("date", "u1", 6), ("time_us", "<u4"), ("factory", "u1")]
    )  # fmt: skip


def _returns(
    model: str, unit_m: NDArray[np.float64], blocks: NDArray[np.void], time_ns: NDArray[np.int64]
) -> PacketReturns:
    """Return the returns of blocks (P, B) and times (P, G, 1, lasers)."""
    packets, count = blocks.shape
    groups, lasers = time_ns.shape[1], time_ns.shape[3]
    shape = (packets, groups, count // groups, lasers)
    counts = without_repeats(blocks["returns"]["range"].astype(np.int64).reshape(shape))
    return PacketReturns(
        range_m=counts * unit_m.reshape(*shape[:3], 1),
        azimuth_deg=blocks["azimuth"].reshape(*shape[:3], 1) / 100 + AZIMUTH_DEG[model],
        elevation_deg=ELEVATION_DEG[model],
        intensity=blocks["returns"]["intensity"].reshape(shape).astype(np.int64),
        ring=np.arange(lasers, dtype=np.int64),
        time_ns=time_ns,
        zero_deg=90.0,
    )


def _echoes(mode: int, blocks: int) -> int:
    """Return the number of returns per pulse in a mode; 1 if it is unknown or does not divide the blocks."""
    echoes = 3 if mode == THREE_RETURNS else 2 if mode in TWO_RETURNS else 1
    return echoes if blocks % echoes == 0 else 1
