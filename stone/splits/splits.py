"""Splits of a dataset into train, val and test, and the findings about them.

**Conventions.** A finding has a rule's code, one sentence, and the ids of the affected sequences. `error`: the rule is
violated. `warning`: the data do not allow the rule, or lack an attribute that it requires. The whole given catalogue
determines which conditions the data allow. A condition can be in every non-empty split if enough drives (≥ 20 s each)
have it. If there are both train and test, they must be in at least two regions.

A drive is a set of sequences that continue each other (`stone/splits/drives.py`), or a single sequence. It corresponds
to the paper's sequence: a dataset in chunks is judged by its drives.

Rules (Park et al., STONE Dataset, ICRA 2026): 43 whole sequences as 31 train, 7 val, 5 test. Each split has day and
night and every environment. Test regions are disjoint from train. Each sequence lasts at least 20 s.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

from stone.splits.composition import CatalogueEntry
from stone.splits.surroundings import ENVIRONMENTS, HALVES
from stone_base.counts import counted
from stone_base.names import PARTS as PARTS
from stone_base.names import Part as Part

Severity = Literal["error", "warning"]

SHORTEST_S = 20.0
MOST_SEQUENCES = 2000

WHOLE = "whole_sequences"
DRIVES = "whole_drives"
LENGTH = "sequence_length"
REGIONS = "test_regions"
LIGHT = "day_and_night"
SEPARATED_PLACES = "every_environment"
SIZES = "split_sizes"
UNSAID = "not_said"
EXPOSED = "test_is_public"


@dataclass(frozen=True)
class Split:
    """The sequence ids of each part."""

    train: tuple[str, ...] = ()
    val: tuple[str, ...] = ()
    test: tuple[str, ...] = ()

    @property
    def parts(self) -> Mapping[Part, tuple[str, ...]]:
        return {"train": self.train, "val": self.val, "test": self.test}

    @property
    def filled(self) -> tuple[Part, ...]:
        """The parts that are not empty."""
        return tuple(part for part, ids in self.parts.items() if ids)

    @property
    def sizes(self) -> tuple[int, int, int]:
        return len(self.train), len(self.val), len(self.test)


@dataclass(frozen=True)
class RuleFinding:
    """A rule's finding: violated (`error`), or infeasible with these data (`warning`)."""

    code: str
    severity: Severity
    message: str
    sequences: tuple[str, ...] = ()


@dataclass(frozen=True)
class Condition:
    """A word that must occur in every split, the rule that requires it, and the usable sequences that have it."""

    rule: str
    word: str
    entries: tuple[CatalogueEntry, ...]

    def obstacle(self, parts: tuple[Part, ...]) -> str:
        """Return why the data do not allow the condition in all of `parts`; '' if they do."""
        regions = {entry.region_key for entry in self.entries}
        drives = len({entry.drive_key for entry in self.entries})
        if drives < len(parts):
            available = counted(len(self.entries), "sequence")
            available += f" of {counted(drives, 'drive')}" if drives < len(self.entries) else ""
            return f"only {available} of at least 20 s, but {len(parts)} splits each require one"
        if {"train", "test"} <= {*parts} and len(regions) < 2:
            return f"its {len(self.entries)} sequences lie in one region, and test and train must not share a region"
        return ""


def is_long_enough(entry: CatalogueEntry) -> bool:
    """Return whether the sequence, or its drive, has the minimum duration."""
    return max(entry.duration_s, entry.drive_s) >= SHORTEST_S


def conditions_of(catalogue: Iterable[CatalogueEntry]) -> tuple[Condition, ...]:
    """Return day and night, then each environment, with the sufficiently long sequences that have it."""
    usable = tuple(entry for entry in catalogue if is_long_enough(entry))
    light = [Condition(LIGHT, half, tuple(e for e in usable if e.half == half)) for half in HALVES]
    others = sorted({entry.environment for entry in usable if entry.environment} - {*ENVIRONMENTS})
    words = (*ENVIRONMENTS, *others)
    places = [Condition(SEPARATED_PLACES, word, tuple(e for e in usable if e.environment == word)) for word in words]
    return (*light, *places)


def drives_in(entries: Iterable[CatalogueEntry]) -> Iterator[tuple[str, tuple[CatalogueEntry, ...]]]:
    """Yield the drives with several of these sequences, by name."""
    drives = dict[str, list[CatalogueEntry]]()
    for entry in entries:
        if entry.drive:
            drives.setdefault(entry.drive, []).append(entry)
    yield from ((name, tuple(members)) for name, members in sorted(drives.items()) if len(members) > 1)


def twins_of(entries: Iterable[CatalogueEntry]) -> Iterator[tuple[str, tuple[CatalogueEntry, ...]]]:
    """Yield groups of duplicate sequences with their common property: a name, or a recording."""
    rows = sorted(entries, key=lambda entry: entry.id)
    names, recordings = dict[str, list[CatalogueEntry]](), dict[str, list[CatalogueEntry]]()
    for entry in rows:
        names.setdefault(entry.name.casefold(), []).append(entry)
        for sha256 in sorted(set(entry.recordings)):
            recordings.setdefault(sha256, []).append(entry)
    yield from (("their name", tuple(group)) for group in names.values() if len(group) > 1)
    yield from (("a recording", tuple(group)) for group in recordings.values() if len(group) > 1)
