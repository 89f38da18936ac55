"""Split proposals by a solver: a split that keeps the rules with similar parts, or a set of conflicting rules.

**Conventions.** Binary x[s, p]: sequence s is in part p; y[r]: region r belongs to test. First, the cheapest violation
of the rules is computed (`COSTS`; zero if all can be kept). Then, at no higher cost, the parts are made similar: each
part's duration and its T, P and N voxels should match the whole. The objective is the sum of absolute deviations, each
relative to the part's expected value. A conflict is irreducible: rules are dropped one by one as long as the rest still
conflict. HiGHS solves the problem through `scipy.optimize.milp` in one thread, limited by nodes instead of seconds:
equal catalogues give equal proposals, in any order.
"""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

from stone.errors import Refused
from stone.splits.composition import CatalogueEntry, region_names, sums_of
from stone.splits.model import COSTS, Model, Rule, SolverLimits, SplitTask, rules_of
from stone.splits.rules import check_split
from stone.splits.splits import (
    DRIVES,
    LENGTH,
    MOST_SEQUENCES,
    PARTS,
    REGIONS,
    SIZES,
    WHOLE,
    RuleFinding,
    Split,
    drives_in,
    is_long_enough,
    twins_of,
)

__all__ = ["COSTS", "PartShares", "Proposal", "SolverLimits", "propose"]

NAMED = 8


@dataclass(frozen=True)
class PartShares:
    """Shares of a part: ratio of all assigned seconds; T, P, N of its occupied voxels (None: voxels unknown)."""

    sequences: int
    duration_ratio: float
    class_ratios: tuple[float, float, float] | None


@dataclass(frozen=True)
class Proposal:
    """A split, and whether it keeps the rules.

    `is_feasible`: every rule is kept as far as the data allow. Otherwise `conflict` is a minimal set of rules that
    cannot all be kept, each with the figures that cause it. `findings` are the checks' findings about the split.
    `is_best`: proven that no split violates the rules less or is more similar by more than the solver's gap; False if
    the solver stopped at its limits.
    """

    split: Split
    conflict: tuple[RuleFinding, ...]
    findings: tuple[RuleFinding, ...]
    whole: PartShares
    shares: tuple[PartShares, PartShares, PartShares]
    is_best: bool

    @property
    def is_feasible(self) -> bool:
        return not self.conflict


def propose(
    catalogue: Iterable[CatalogueEntry], sizes: tuple[int, int, int], limits: SolverLimits | None = None
) -> Proposal:
    """Return the best split of `catalogue` into parts of these sizes (train, val, test); other sequences are in no
    part.

    Raises `bad_split_sizes`, `empty_catalogue`, `catalogue_too_large`.
    """
    entries = tuple(sorted(catalogue, key=lambda entry: (entry.name, entry.id)))
    if not all(0 <= size <= MOST_SEQUENCES for size in sizes) or not any(sizes):
        raise Refused(
            "bad_split_sizes",
            f"sizes {sizes} are invalid; expected three integers (train, val, test) from 0 to "
            f"{MOST_SEQUENCES}, at least one above 0",
        )
    if not entries:
        raise Refused("empty_catalogue", "no labelled sequence is available for the splits; process some first")
    if len(entries) > MOST_SEQUENCES:
        raise Refused(
            "catalogue_too_large",
            f"{len(entries)} sequences are to be divided; the limit is {MOST_SEQUENCES}, leave some out",
        )
    model = Model(SplitTask(entries, sizes), limits or SolverLimits())
    bent = model.least_bent()
    conflict = _clash(model) if bent.cost > 0 else ()
    solved = model.most_alike(bent)
    split = _split(entries, solved.parts)
    return Proposal(
        split=split,
        conflict=tuple(_reason(rule, model.sought) for rule in conflict),
        findings=check_split(split, entries, sizes),
        whole=_shares(entries, split, (0, 1, 2)),
        shares=(_shares(entries, split, (0,)), _shares(entries, split, (1,)), _shares(entries, split, (2,))),
        is_best=bent.is_proven and solved.is_proven,
    )


def _clash(model: Model) -> tuple[Rule, ...]:
    """Return a minimal conflict by the deletion filter (Chinneck 2008, §6.1)."""
    kept = list(rules_of(model.sought))
    for rule in tuple(kept):
        others = [other for other in kept if other != rule]
        if not model.can_be_kept(others):
            kept = others
    return tuple(kept)


def _split(entries: tuple[CatalogueEntry, ...], parts: tuple[int, ...]) -> Split:
    """Return the split; `parts` is the part number of each entry, −1 for none."""
    train, val, test = (
        tuple(entry.id for entry, of in zip(entries, parts, strict=True) if of == part) for part in range(len(PARTS))
    )
    return Split(train, val, test)


def _shares(entries: tuple[CatalogueEntry, ...], split: Split, parts: tuple[int, ...]) -> PartShares:
    of_parts = {entry_id for part in parts for entry_id in tuple(split.parts.values())[part]}
    everything = {entry_id for ids in split.parts.values() for entry_id in ids}
    sums = sums_of(entry for entry in entries if entry.id in of_parts)
    whole = sums_of(entry for entry in entries if entry.id in everything)
    return PartShares(
        sequences=sums.sequences,
        duration_ratio=sums.duration_s / whole.duration_s if whole.duration_s else 0.0,
        class_ratios=sums.class_shares(),
    )


def _reason(rule: Rule, sought: SplitTask) -> RuleFinding:
    """Return the figures that put this rule into the conflict."""
    concerned, message = _facts(rule, sought)
    return RuleFinding(rule.code, "error", message, tuple(sorted(entry.id for entry in concerned)))


def _facts(rule: Rule, sought: SplitTask) -> tuple[tuple[CatalogueEntry, ...], str]:
    entries, sizes = sought.entries, sought.sizes
    usable = tuple(entry for entry in entries if is_long_enough(entry))
    if rule.code == SIZES:
        requested = f"{' + '.join(map(str, sizes))} = {sum(sizes)} sequences are requested for train, val and test"
        return (), f"{requested}; {len(entries)} exist, {len(usable)} of at least 20 s"
    if rule.code == LENGTH:
        short = tuple(entry for entry in entries if not is_long_enough(entry))
        return short, f"{len(short)} of {len(entries)} sequences are shorter than 20 s: {_names(short)}"
    if rule.code == WHOLE:
        twins = tuple({entry.id: entry for _, group in twins_of(usable) for entry in group}.values())
        return (
            twins,
            f"{len(twins)} sequences share a name or a recording, one of each can be used: {_names(twins)}",
        )
    if rule.code == DRIVES:
        drives = tuple(drives_in(entries))
        chunks = tuple(entry for _, members in drives for entry in members)
        largest = sorted(drives, key=lambda drive: (-len(drive[1]), drive[0]))[:NAMED]
        named = ", ".join(f"{name} {len(members)}" for name, members in largest)
        return chunks, f"a drive must be in one split; {len(drives)} drives have several sequences: {named}"
    if rule.code == REGIONS:
        counted = _by_region(usable)
        return (), f"test and train must not share a region, and regions are not divided; the data contain {counted}"
    return (
        rule.entries,
        f"{rule.word} in each split: {len(rule.entries)} sequences have it, in {_by_region(rule.entries)}",
    )


def _by_region(entries: tuple[CatalogueEntry, ...]) -> str:
    counts = Counter(name or "(unspecified)" for name in region_names(entries).values())
    largest = sorted(counts.items(), key=lambda item: (-item[1], item[0]))
    more = f" and {len(largest) - NAMED} more" if len(largest) > NAMED else ""
    named = ", ".join(f"{name} {count}" for name, count in largest[:NAMED])
    return f"{len(largest)} region(s): {named}{more}"


def _names(entries: tuple[CatalogueEntry, ...]) -> str:
    more = f" and {len(entries) - NAMED} more" if len(entries) > NAMED else ""
    return ", ".join(entry.name for entry in entries[:NAMED]) + more
