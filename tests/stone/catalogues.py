"""Catalogues of sequences that were never driven."""

from collections.abc import Sequence
from random import Random

from stone.splits.composition import CatalogueEntry, Voxels
from stone.splits.surroundings import DAYLIGHT, ENVIRONMENTS, ILLUMINATIONS

DAYS = [word for word in ILLUMINATIONS if DAYLIGHT[word] == "day"]
NIGHTS = [word for word in ILLUMINATIONS if DAYLIGHT[word] == "night"]


def entry(number: int, **said: object) -> CatalogueEntry:
    """A sequence of 100 s by day on a farm, in a region of its own, unless said otherwise."""
    facts: dict[str, object] = {
        "id": f"{number:032x}",
        "name": f"run-{number:02d}",
        "environment": "farmland",
        "illumination": "day",
        "region": f"region-{number}",
        "duration_s": 100.0,
        "frames": 1000,
        "voxels": (100, 200, 700),
        "distance_m": 120.0,
    }
    return CatalogueEntry(**{**facts, **said})  # type: ignore[arg-type]


def catalogue(sequences: int, seed: int, regions: int = 9) -> tuple[CatalogueEntry, ...]:
    """Sequences of every environment, a third of them by night, of 25 to 240 s, in some regions."""
    random = Random(seed)
    made = []
    for number in range(sequences):
        illumination = random.choice(NIGHTS if number % 3 == 0 else DAYS)
        region, duration_s = f"region-{random.randrange(regions)}", random.uniform(25.0, 240.0)
        said = {"environment": ENVIRONMENTS[number % 4], "illumination": illumination, "region": region}
        made.append(entry(number, **said, duration_s=duration_s, voxels=voxels(random, duration_s)))
    return tuple(made)


def voxels(random: Random, duration_s: float) -> Voxels:
    """Some ten thousand occupied voxels a frame, some of each class."""
    occupied, t, p = duration_s * random.uniform(5e4, 1.5e5), random.uniform(0.05, 0.3), random.uniform(0.1, 0.4)
    return int(occupied * t), int(occupied * p), int(occupied * (1 - t - p))


def shuffled(entries: Sequence[CatalogueEntry], seed: int) -> tuple[CatalogueEntry, ...]:
    return tuple(Random(seed).sample(entries, len(entries)))
