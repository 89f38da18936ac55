"""Labelled sequences for the dataset's pages: places, lights and regions as a campaign has them, a few blobs each.

**Conventions.** Lengths and counts are made by formula, so that they differ between sequences; two regions, so that
test can lie apart.
"""

from dataclasses import dataclass

from services.domain.datasets.splits import lock_splits, replace_splits
from services.runtime.orm import LabelSet, SequenceRow
from services.runtime.platform import Platform
from stone.splits.splits import Split
from testing.api.serving import Person
from testing.worlds import made

CAMPAIGN = (
    ("farmland", "sunny", "Gyeonggi"), ("farmland", "night", "Gyeonggi"), ("farmland", "dusk", "Gangwon"),
    ("farmland", "moonlit", "Jeolla"), ("mountain", "sunny", "Gyeonggi"), ("mountain", "night", "Gangwon"),
    ("mountain", "overcast", "Jeolla"), ("lake", "dusk", "Gyeonggi"), ("lake", "overcast", "Gangwon"),
    ("lake", "night", "Jeolla"), ("construction", "floodlit", "Gyeonggi"), ("construction", "sunny", "Gangwon"),
    ("construction", "overcast", "Jeolla"),
)  # fmt: skip
APART = {"Gyeonggi": "train", "Jeolla": "val", "Gangwon": "test"}
"""A split that keeps every rule: each region in a part of its own."""


@dataclass(frozen=True)
class Driven:
    """A labelled sequence."""

    id: str
    name: str
    region: str


def campaign(platform: Platform, owner: Person) -> tuple[Driven, ...]:
    """One sequence for each line of `CAMPAIGN`."""
    return tuple(driven(platform, owner, number) for number in range(len(CAMPAIGN)))


def driven(platform: Platform, owner: Person, number: int, name: str = "") -> Driven:
    """The sequence of a line of `CAMPAIGN`."""
    environment, illumination, region = CAMPAIGN[number]
    name = name or f"{environment}-{number + 3:02d}"
    with platform.database.transaction() as session:
        row = SequenceRow(owner_id=owner.user_id, name=name, environment=environment)
        row.illumination, row.region = illumination, region
        session.add(row)
        session.flush()
        facts = {"id": row.id, "name": row.name, "owner_id": owner.user_id}
    made.labels(platform, facts, seed=facts["id"].encode())
    with platform.database.transaction() as session:
        labels = session.query(LabelSet).where(LabelSet.sequence_id == facts["id"]).one()
        seconds = 64 + 17 * number % 83
        labels.frames, labels.duration_ns, labels.distance_m = 10 * seconds, seconds * 10**9, 1.1 * seconds
        labels.t_voxels, labels.p_voxels, labels.n_voxels = 90_000 + 9000 * number, 150_000, 400_000 - 20_000 * number
    return Driven(facts["id"], facts["name"], region)


def chunks(platform: Platform, owner: Person, drives: int, each: int) -> tuple[tuple[str, ...], ...]:
    """The ids of the sequences of drives: so many each of 20 s, one after the other at 1 m/s, drives an hour apart."""
    found = tuple(
        tuple(driven(platform, owner, drive % len(CAMPAIGN), f"run-{drive:02d}-{at}").id for at in range(each))
        for drive in range(drives)
    )
    with platform.database.transaction() as session:
        for drive, ids in enumerate(found):
            for number, one in enumerate(ids):
                labels = session.query(LabelSet).where(LabelSet.sequence_id == one).one()
                labels.frames, labels.duration_ns = 200, 20 * 10**9
                first_ns, begin_m = 10**18 + (drive * 3600 + number * 20) * 10**9, 20.0 * number
                labels.track = {
                    "log": f"log-{drive}", "vehicle": "n1", "map": "dataset:lake", "period_ns": 10**8, "speed_m_s": 1.0,
                    "first_ns": first_ns, "last_ns": first_ns + 19_900_000_000,
                    "places": [[0.0, begin_m, 0.0, 0.0], [19.9, begin_m + 19.9, 0.0, 0.0]],
                }  # fmt: skip
    return found


def put_apart(platform: Platform, sequences: tuple[Driven, ...]) -> Split:
    """Put the splits that keep every rule."""
    of = {part: tuple(one.id for one in sequences if APART[one.region] == part) for part in ("train", "val", "test")}
    return put(platform, Split(**of))


def put(platform: Platform, split: Split) -> Split:
    """Put these splits, whatever the rules say."""
    with platform.database.transaction() as session:
        replace_splits(session, lock_splits(session), split)
    return split
