"""The time order of ground truth frames and the drives of their sequences, from the tables beside them.

**Conventions.** A table is a `frames.parquet` (`services/labeler/tables.py`): beside `gts`, or in the folder of a
sequence below it if a folder contains several label sets. Without it, tables of the nuScenes schema beside `gts` are
read. Frame tokens are hashes, so their own order means nothing.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from stone.splits.drives import DrivenTrack, driven_track, drives_of
from stone_submissions.errors import GroundTruthError
from stone_submissions.ground_truth import TimedSequence

TABLE = "frames.parquet"
COLUMNS = ("frame_token", "stamp_ns")
PLACE = ("x_m", "y_m", "z_m")


@dataclass(frozen=True)
class _FrameTable:
    """Stamps and, if the table has them, positions of frames by token; the vehicle, and the origin of the positions'
    map.
    """

    stamps_ns: dict[str, int] = field(default_factory=dict)
    places_m: dict[str, tuple[float, ...]] = field(default_factory=dict)
    vehicle: str = ""
    origin_deg_m: tuple[float, float, float] | None = None


def in_time_order(root: Path, sequences: Mapping[str, Sequence[str]]) -> dict[str, TimedSequence] | None:
    """Return the tokens of each sequence in stamp order, and its drive; None if a frame is in none of the tables.

    `root` is the folder of the sequences. Raises `GroundTruthError` for an unreadable table, and a `DatasetFaultError`.
    """
    folder = root.parent if root.name == "gts" else root
    beside = _frame_table(folder / TABLE)
    ordered, tracks = dict[str, list[str]](), dict[str, DrivenTrack]()
    firsts = dict[str, int]()
    for name, tokens in sequences.items():
        own = _frame_table(root / name / TABLE)
        stamps_ns = beside.stamps_ns | own.stamps_ns
        if not all(token in stamps_ns for token in tokens):
            return _published(folder, sequences)
        ordered[name] = sorted(tokens, key=lambda token: (stamps_ns[token], token))
        firsts[name] = stamps_ns[ordered[name][0]]
        if (track := _track(own if own.stamps_ns else beside, ordered[name])) is not None:
            tracks[name] = track
    drives = drives_of(tracks)
    return {name: TimedSequence(tuple(ordered[name]), firsts[name], _named(drives.get(name, ()))) for name in sequences}


def _named(drive: Sequence[str]) -> str | None:
    """Return the name of a drive of several sequences: the name of its first sequence."""
    return drive[0] if len(drive) > 1 else None


def _published(folder: Path, sequences: Mapping[str, Sequence[str]]) -> dict[str, TimedSequence] | None:
    """Return the order and drives from tables of the nuScenes schema."""
    if not any(folder.glob("v1.0-*")):
        return None
    from stone_datasets.drives import drives_among
    from stone_datasets.reading import read_dataset

    known = {item.name: item for item in read_dataset(folder).sequences if item.name in sequences}
    drive_of = {name: drive for drive in drives_among(list(known.values())) for name in drive}
    timed = dict[str, TimedSequence]()
    for name, tokens in sequences.items():
        if name not in known or not set(tokens) <= set(known[name].tokens):
            return None
        listed, wanted = known[name].tokens, set(tokens)
        first_ns = int(known[name].stamps_ns[listed.index(next(item for item in listed if item in wanted))])
        ordered = tuple(token for token in listed if token in wanted)
        timed[name] = TimedSequence(ordered, first_ns, _named(drive_of.get(name, ())))
    return timed


def _track(table: _FrameTable, tokens: Sequence[str]) -> DrivenTrack | None:
    """Return the track of frames in time order; None if the table lacks a position, or two frames have one stamp."""
    from services.labeler.totals import common_map

    if any(token not in table.places_m for token in tokens):
        return None
    stamps_ns = np.array([table.stamps_ns[token] for token in tokens], np.int64)
    places_m = np.array([table.places_m[token] for token in tokens])
    if (np.diff(stamps_ns) <= 0).any() or not np.isfinite(places_m).all():
        return None
    origin, common_from_map = common_map(table.origin_deg_m, table.vehicle)
    return driven_track(stamps_ns, common_from_map @ places_m, origin)


def _frame_table(path: Path) -> _FrameTable:
    """Return the table of frames that have labels; an empty table without a file."""
    if not path.is_file():
        return _FrameTable()
    import pyarrow as pa
    import pyarrow.compute as pc
    import pyarrow.parquet as pq

    try:
        table = pq.read_table(path)
        table = table.filter(pc.is_valid(table["frame_token"]))
        tokens = [str(token) for token in table["frame_token"].to_pylist()]
        stamps_ns = np.array(table["stamp_ns"].to_pylist(), np.int64).tolist()
        has_places = set(PLACE) <= set(table.column_names)
        places = np.array([table[name].to_pylist() for name in PLACE], np.float64).T.tolist() if has_places else []
        about = json.loads((table.schema.metadata or {}).get(b"stone", b"{}"))
        stated = about.get("map_origin_deg_m")
        origin = None if stated is None else tuple(map(float, stated))
        if origin is not None and not (len(origin) == 3 and np.isfinite(origin).all()):
            raise ValueError(f"map_origin_deg_m is {str(stated)[:60]}")
        places_m = dict(zip(tokens, places, strict=False))
        return _FrameTable(dict(zip(tokens, stamps_ns, strict=True)), places_m, str(about.get("vehicle", "")), origin)
    except (OSError, KeyError, TypeError, ValueError, OverflowError, AttributeError, pa.ArrowException) as error:
        raise GroundTruthError(path, f"no table of frames: {error}") from error
