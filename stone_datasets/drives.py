"""The drives of a published dataset by log, vehicle, stamps and poses, and the splits that divide a drive."""

from collections import Counter
from collections.abc import Iterator, Sequence

from stone.splits.drives import TrackOrigin, driven_track, drives_of
from stone_datasets.faults import DatasetFaultError, DatasetPlace, quoted
from stone_datasets.index import DatasetIndex, DatasetSequence
from stone_datasets.splits import ALL


def drives_among(sequences: Sequence[DatasetSequence]) -> tuple[tuple[str, ...], ...]:
    """Return the sequence names of each drive, a series of sequences that continue each other."""
    origins = {
        sequence.name: origin_of((sequence.logfile, sequence.vehicle, sequence.location), sequence.name)
        for sequence in sequences
    }
    tracks = {
        sequence.name: driven_track(sequence.stamps_ns, sequence.map_from_ego.translation_m, origins[sequence.name])
        for sequence in sequences
    }
    drives = drives_of({name: track for name, track in tracks.items() if track is not None})
    return tuple(dict.fromkeys(drives[name] for name in tracks if name in drives))


def torn_drives(index: DatasetIndex) -> Iterator[DatasetFaultError]:
    """Yield `DST-044` for each drive that is in two splits."""
    split_of = {name: split for split, names in index.splits.items() if split != ALL for name in names}
    for drive in drives_among(index.sequences) if split_of else ():
        counts = Counter(split_of[name] for name in drive if name in split_of)
        if len(counts) > 1:
            distribution = " and ".join(f"{count} in {quoted(split)}" for split, count in counts.items())
            what = f"the {len(drive)} scenes of the drive that starts with {quoted(drive[0])} are {distribution}"
            yield DatasetFaultError("DST-044", DatasetPlace("splits"), what)


def origin_of(log: tuple[str, str, str], name: str) -> TrackOrigin:
    """Return the origin of a scene's track by the logfile, vehicle and location of its log.

    Poses of one location share a map, as in nuScenes.
    """
    logfile, vehicle, location = log
    return TrackOrigin(logfile, vehicle, f"dataset:{(location or logfile or name).casefold()}")
