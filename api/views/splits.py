"""Splits as the API shows them: entries of the catalogue and findings of rules become bodies."""

from collections.abc import Iterable
from typing import TYPE_CHECKING

from api.schemas.splits import GapItem, ProposalAnswer, RuleItem, Shares, SharesItem, SplitEntry, SplitsAnswer
from services.domain.datasets.splits import CurrentSplits, gap_record
from services.domain.datasets.statistics import CLASSES
from stone.splits.composition import CatalogueEntry
from stone.splits.splits import PARTS, RuleFinding, Split

if TYPE_CHECKING:  # imports scipy's solver
    from stone.splits.proposal import PartShares, Proposal


def splits_answer(
    current: CurrentSplits, seen: tuple[CatalogueEntry, ...], findings: Iterable[RuleFinding] | None
) -> SplitsAnswer:
    """Return the splits with their sequences in `seen`; findings only for callers who see all."""
    return SplitsAnswer.of(
        current,
        sizes=dict(zip(PARTS, current.split.sizes, strict=True)),
        **_assigned(current.split, seen),
        unassigned=[entry_item(entry) for entry in seen if entry.id not in _ids(current.split)],
        findings=None if findings is None else rule_items(findings),
        gap=None if findings is None else gap_item(current.split, seen),
    )


def proposal_answer(proposal: "Proposal", seen: tuple[CatalogueEntry, ...]) -> ProposalAnswer:
    """Return a proposal with its sequences in full."""
    train, val, test = (_shares(share) for share in proposal.shares)
    return ProposalAnswer.of(
        proposal,
        **_assigned(proposal.split, seen),
        gap=gap_item(proposal.split, seen),
        shares=Shares(whole=_shares(proposal.whole), train=train, val=val, test=test),
    )


def rule_items(findings: Iterable[RuleFinding]) -> list[RuleItem]:
    return [RuleItem.of(finding) for finding in findings]


def gap_item(split: Split, seen: tuple[CatalogueEntry, ...]) -> GapItem | None:
    record = gap_record(split, seen)
    return None if record is None else GapItem(**record)


def entry_item(entry: CatalogueEntry) -> SplitEntry:
    voxels = None if entry.voxels is None else dict(zip(CLASSES, entry.voxels, strict=True))
    return SplitEntry.of(entry, sequence_id=entry.id, daylight=entry.half, voxels=voxels, **entry.quality.as_record())


def _assigned(split: Split, seen: tuple[CatalogueEntry, ...]) -> dict[str, list[SplitEntry]]:
    return {part: [entry_item(entry) for entry in seen if entry.id in {*ids}] for part, ids in split.parts.items()}


def _ids(split: Split) -> set[str]:
    return {sequence_id for ids in split.parts.values() for sequence_id in ids}


def _shares(shares: "PartShares") -> SharesItem:
    ratios = shares.class_ratios
    of_classes = None if ratios is None else dict(zip(CLASSES, ratios, strict=True))
    return SharesItem.of(shares, class_ratios=of_classes)
