"""Packets of Velodyne's VLP-16, VLP-32C and VLS-128 as returns.

**Conventions.** A packet has twelve blocks of a bank, an azimuth (hundredths of a degree) and 32 ranges. Blocks fired
together form a sequence, during which the azimuth advances to that of the next sequence. In dual mode a block of last
returns is followed by one of the strongest. Source: user manuals 63-9243 (VLP-16), 63-9325 (VLP-32C), 63-9483
(VLS-128).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone_recordings.messages.lidars.models import VELODYNE_BYTES, LidarModel
from stone_recordings.messages.lidars.points import (
    AZIMUTH_DEG,
    ELEVATION_DEG,
    PacketReturns,
    packet_times_ns,
    without_repeats,
)

BLOCKS, LASERS = 12, 32
_RECORD = np.dtype([("range", "<u2"), ("intensity", "u1")])
_BLOCK = np.dtype([("bank", "<u2"), ("azimuth", "<u2"), ("returns", _RECORD, LASERS)])
_PACKET = np.dtype([("blocks", _BLOCK, BLOCKS), ("time_us", "<u4"), ("mode", "u1"), ("product", "u1")])
DUAL = 0x39
HOUR_US = 3_600_000_000
BANKS = (0xEEFF, 0xDDFF, 0xCCFF, 0xBBFF)
# A larger step than any sensor turns in a sequence: packets between the two were lost.
MOST_STEP = 300


@dataclass(frozen=True)
class _Firing:
    """The firing pattern of a model: blocks per sequence, each of one bank, and sequences per packet."""

    unit_m: float
    blocks: int
    firings: int
    cycle_ns: int
    laser_ns: NDArray[np.int64]


_FIRST = np.arange(LASERS)
FIRINGS: dict[str, _Firing] = {
    "VLP-16": _Firing(0.002, 1, 2, 110_592, _FIRST // 16 * 55_296 + _FIRST % 16 * 2_304),
    "VLP-32C": _Firing(0.004, 1, 1, 55_296, _FIRST // 2 * 2_304),
    "VLS-128": _Firing(0.004, 4, 1, 53_300, (np.arange(128) // 8 + np.arange(128) // 64) * 2_665 - 8_700),
}


def velodyne_returns(packets: list[memoryview], model: LidarModel, stamps_ns: NDArray[np.int64]) -> PacketReturns:
    """Return P packets of one model, P > 0, as (P, sequences, returns, lasers)."""
    raw = np.frombuffer(b"".join(packet[:VELODYNE_BYTES] for packet in packets), _PACKET)
    firing, is_dual = FIRINGS[model], bool(raw["mode"][0] == DUAL)
    echoes = 2 if is_dual else 1
    sequences = BLOCKS // (firing.blocks * echoes)
    used = raw["blocks"][:, : sequences * firing.blocks * echoes]
    shape = (len(raw), sequences, firing.blocks, echoes)
    is_bank = (used["bank"].reshape(shape) == np.array(BANKS[: firing.blocks])[:, None])[..., None]
    returns = used["returns"].reshape(*shape, LASERS)
    counts = np.where(is_bank & (raw["mode"] == raw["mode"][0])[:, None, None, None, None], returns["range"], 0)
    counts, intensity = _by_echo(counts.astype(np.int64)), _by_echo(returns["intensity"].astype(np.int64))
    begin, step = _azimuths(used["azimuth"].reshape(shape)[:, :, 0, 0].astype(np.int64))
    turned = step[:, :, None] * (firing.laser_ns / firing.cycle_ns)
    elevation_deg = np.resize(ELEVATION_DEG[model], len(firing.laser_ns))
    sent_ns = packet_times_ns(raw["time_us"].astype(np.int64), HOUR_US, stamps_ns)
    fired_ns = sent_ns[:, None, None] + np.arange(sequences)[:, None] * firing.cycle_ns + firing.laser_ns
    return PacketReturns(
        range_m=np.asarray(without_repeats(counts) * firing.unit_m, np.float64),
        azimuth_deg=((begin[:, :, None] + turned) / 100 + np.resize(AZIMUTH_DEG[model], len(turned[0, 0])))[:, :, None],
        elevation_deg=elevation_deg,
        intensity=intensity,
        ring=np.unique(elevation_deg, return_inverse=True)[1].astype(np.int64),
        time_ns=fired_ns[:, :, None],
        zero_deg=0.0,
    )


def _by_echo(values: NDArray[np.int64]) -> NDArray[np.int64]:
    """Reorder (P, S, B, E, 32) as (P, S, E, 32 B): the lasers of all banks of a sequence side by side."""
    packets, sequences, banks, echoes, lasers = values.shape
    return values.transpose(0, 1, 3, 2, 4).reshape(packets, sequences, echoes, banks * lasers)


def _azimuths(begin: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return azimuths (P, S) and the turn of each sequence, in hundredths of a degree; the last turn repeats the
    previous.
    """
    flat = begin.reshape(-1)
    step = np.zeros_like(flat)
    step[:-1] = (np.diff(flat) + 18_000) % 36_000 - 18_000
    known = step[:-1][np.abs(step[:-1]) <= MOST_STEP]
    usual = int(np.median(known)) if len(known) else 0
    is_lost = np.abs(step) > MOST_STEP
    is_lost[-1] = True
    return begin, np.where(is_lost, usual, step).reshape(begin.shape)
