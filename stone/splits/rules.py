"""The paper's rules for a split, each a separate check that returns findings.

**Conventions.** As in `stone/splits/splits.py`. Checks are independent of the solver, so that they can judge its
proposals. `catalogue` is all data: sequences in no split count for what the data allow.
"""

from collections import Counter
from collections.abc import Iterable, Iterator

from stone.splits.composition import CatalogueEntry
from stone.splits.splits import (
    DRIVES,
    EXPOSED,
    LENGTH,
    LIGHT,
    REGIONS,
    SEPARATED_PLACES,
    SHORTEST_S,
    SIZES,
    UNSAID,
    WHOLE,
    Part,
    RuleFinding,
    Split,
    conditions_of,
    drives_in,
    is_long_enough,
    twins_of,
)
from stone_base.counts import counted

NAMED = 3


def check_whole(split: Split, catalogue: Iterable[CatalogueEntry]) -> tuple[RuleFinding, ...]:
    """Check that every sequence is known, in one part, once, and without a duplicate."""
    known = {entry.id: entry for entry in catalogue}
    times = Counter(entry_id for ids in split.parts.values() for entry_id in ids)
    unknown = tuple(sorted(entry_id for entry_id in times if entry_id not in known))
    repeated = tuple(sorted(entry_id for entry_id, count in times.items() if count > 1))
    findings = []
    if unknown:
        findings.append(_error(WHOLE, f"{_many(unknown)} not in the catalogue of labelled sequences", unknown))
    if repeated:
        findings.append(_error(WHOLE, f"{_many(repeated)} listed more than once; use each in one split", repeated))
    assigned = [known[entry_id] for entry_id in sorted(times) if entry_id in known]
    for why, twins in twins_of(assigned):
        ids = tuple(entry.id for entry in twins)
        names = ", ".join(entry.name for entry in twins)
        findings.append(_error(WHOLE, f"{names} share {why}, so only one of them can be used", ids))
    return tuple(findings)


def check_drives(split: Split, catalogue: Iterable[CatalogueEntry]) -> tuple[RuleFinding, ...]:
    """Check that no drive is in two splits: its sequences share ground and light, and overlap at their joints."""
    assigned = _assigned(split, catalogue)
    part_of = {entry.id: part for part, entry in assigned}
    findings = []
    for name, members in drives_in(entry for _, entry in assigned):
        names = dict[str, list[str]]()
        for entry in members:
            names.setdefault(part_of[entry.id], []).append(entry.name)
        if len(names) > 1:
            distribution = " and ".join(
                f"{len(members_of_part)} in {part} ({_some(members_of_part)})"
                for part, members_of_part in names.items()
            )
            message = (
                f"drive {name!r} is divided: its {len(members)} consecutive sequences are {distribution}; put "
                "all of them into one split, or remove some so that one split remains"
            )
            findings.append(_error(DRIVES, message, tuple(entry.id for entry in members)))
    return tuple(findings)


def check_length(split: Split, catalogue: Iterable[CatalogueEntry]) -> tuple[RuleFinding, ...]:
    """Check that every sequence, or its drive, lasts at least 20 s."""
    short = [entry for _, entry in _assigned(split, catalogue) if not is_long_enough(entry)]
    return tuple(
        _error(LENGTH, f"{entry.name} lasts {entry.duration_s:.1f} s; the minimum is {SHORTEST_S:g} s", (entry.id,))
        for entry in short
    )


def check_regions(split: Split, catalogue: Iterable[CatalogueEntry]) -> tuple[RuleFinding, ...]:
    """Check that no region of test is a region of train; an unspecified region counts as a region of its own."""
    assigned = _assigned(split, catalogue)
    train = [entry for part, entry in assigned if part == "train"]
    test = [entry for part, entry in assigned if part == "test"]
    findings = []
    for key in sorted({entry.region_key for entry in train} & {entry.region_key for entry in test}):
        of_train = [entry for entry in train if entry.region_key == key]
        of_test = [entry for entry in test if entry.region_key == key]
        named = f"region {of_test[0].region!r}" if key else "an unspecified region"
        others = sorted({repr(entry.region) for entry in of_train} - {repr(of_test[0].region)})
        named += f" (in train {', '.join(others)})" if others else ""
        message = f"{named} is in test ({counted(len(of_test), 'sequence')}) and in train ({len(of_train)})"
        findings.append(_error(REGIONS, message, tuple(entry.id for entry in (*of_train, *of_test))))
    return tuple(findings)


def check_light(split: Split, catalogue: Iterable[CatalogueEntry]) -> tuple[RuleFinding, ...]:
    """Check for day and night in each split, if the data allow."""
    return tuple(_check_conditions(LIGHT, split, tuple(catalogue)))


def check_places(split: Split, catalogue: Iterable[CatalogueEntry]) -> tuple[RuleFinding, ...]:
    """Check for every environment in each split, if the data allow."""
    return tuple(_check_conditions(SEPARATED_PLACES, split, tuple(catalogue)))


def check_sizes(split: Split, sizes: tuple[int, int, int]) -> tuple[RuleFinding, ...]:
    """Check that the splits have the requested numbers of sequences."""
    return tuple(
        _error(SIZES, f"{part} has {counted(len(ids), 'sequence')}; expected {size}")
        for (part, ids), size in zip(split.parts.items(), sizes, strict=True)
        if len(ids) != size
    )


def check_said(split: Split, catalogue: Iterable[CatalogueEntry]) -> tuple[RuleFinding, ...]:
    """Return a warning for each attribute that rules require and sequences lack."""
    entries = [entry for _, entry in _assigned(split, catalogue)]
    silent = {
        "environment": [entry for entry in entries if not entry.environment],
        "illumination": [entry for entry in entries if not entry.half],
        "region": [entry for entry in entries if not entry.region],
    }
    return tuple(
        RuleFinding(UNSAID, "warning", f"{counted(len(of), 'sequence')} without {fact}", tuple(e.id for e in of))
        for fact, of in silent.items()
        if of
    )


def check_exposed(split: Split, catalogue: Iterable[CatalogueEntry]) -> tuple[RuleFinding, ...]:
    """Return a warning for each test sequence whose labels may be known: known labels win the benchmark."""
    exposed = [entry for part, entry in _assigned(split, catalogue) if part == "test" and entry.exposure]
    problem = "is in test, and its labels may be known"
    return tuple(
        RuleFinding(EXPOSED, "warning", f"{entry.name} {problem}: {entry.exposure}", (entry.id,)) for entry in exposed
    )


def check_split(
    split: Split, catalogue: Iterable[CatalogueEntry], sizes: tuple[int, int, int] | None = None
) -> tuple[RuleFinding, ...]:
    """Return errors and warnings of all rules in order; sizes are checked only if they are given."""
    entries = tuple(catalogue)
    checks = (
        check_whole,
        check_drives,
        check_length,
        check_regions,
        check_light,
        check_places,
        check_said,
        check_exposed,
    )
    findings = [finding for check in checks for finding in check(split, entries)]
    return (*findings, *(check_sizes(split, sizes) if sizes is not None else ()))


def _check_conditions(rule: str, split: Split, catalogue: tuple[CatalogueEntry, ...]) -> Iterator[RuleFinding]:
    parts, assigned = split.filled, _assigned(split, catalogue)
    for condition in conditions_of(catalogue):
        if condition.rule != rule:
            continue
        ids = {entry.id for entry in condition.entries}
        missing = [part for part in parts if not any(p == part and entry.id in ids for p, entry in assigned)]
        obstacle = condition.obstacle(parts)
        if missing and obstacle:
            message = f"no {condition.word} sequence in {' and '.join(missing)}; the data do not allow it: {obstacle}"
            yield RuleFinding(rule, "warning", message, tuple(sorted(ids)))
        elif missing:
            message = f"no {condition.word} sequence in {' and '.join(missing)}, although {len(ids)} sequences have it"
            yield _error(rule, message, tuple(sorted(ids)))


def _assigned(split: Split, catalogue: Iterable[CatalogueEntry]) -> list[tuple[Part, CatalogueEntry]]:
    """Return (part, entry) of the split's known sequences, in the split's order."""
    known = {entry.id: entry for entry in catalogue}
    return [(part, known[entry_id]) for part, ids in split.parts.items() for entry_id in ids if entry_id in known]


def _many(ids: tuple[str, ...]) -> str:
    return f"{ids[0]!r} is" if len(ids) == 1 else f"{len(ids)} sequences are"


def _some(names: list[str]) -> str:
    """Return the first names, and the number of further ones."""
    more = len(names) - NAMED
    return ", ".join(names[:NAMED]) + (f" and {more} more" if more > 0 else "")


def _error(code: str, message: str, sequences: tuple[str, ...] = ()) -> RuleFinding:
    return RuleFinding(code, "error", message, sequences)
