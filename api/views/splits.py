"""Splits as the API shows them: entries of the catalogue and findings of rules become bodies."""

from collections.abc import Iterable
from typing import TYPE_CHECKING

from api.schemas.splits import ProposalAnswer, RuleItem, Shares, SharesItem, Sizes, SplitEntry, SplitsAnswer
from api.schemas.statistics import VoxelRatios, VoxelsItem
from services.domain.datasets.splits import CurrentSplits
from services.domain.datasets.statistics import CLASSES
from stone.splits.composition import CatalogueEntry
from stone.splits.splits import RuleFinding, Split

if TYPE_CHECKING:  # with it comes scipy's solver
    from stone.splits.proposal import PartShares, Proposal


def splits_answer(
    current: CurrentSplits, seen: tuple[CatalogueEntry, ...], findings: Iterable[RuleFinding] | None
) -> SplitsAnswer:
    """The splits with those of their sequences that are `seen`; findings for whoever sees all."""
    train, val, test = current.split.sizes
    return SplitsAnswer(
        revision=current.revision,
        sizes=Sizes(train=train, val=val, test=test),
        **_assigned(current.split, seen),
        unassigned=[entry_item(entry) for entry in seen if entry.id not in _ids(current.split)],
        findings=None if findings is None else rule_items(findings),
    )


def proposal_answer(proposal: "Proposal", seen: tuple[CatalogueEntry, ...]) -> ProposalAnswer:
    """A proposal with its sequences in full."""
    train, val, test = (_shares(one) for one in proposal.shares)
    return ProposalAnswer(
        is_feasible=proposal.is_feasible,
        is_best=proposal.is_best,
        **_assigned(proposal.split, seen),
        conflict=rule_items(proposal.conflict),
        findings=rule_items(proposal.findings),
        shares=Shares(whole=_shares(proposal.whole), train=train, val=val, test=test),
    )


def rule_items(findings: Iterable[RuleFinding]) -> list[RuleItem]:
    return [
        RuleItem(code=one.code, severity=one.severity, message=one.message, sequence_ids=list(one.sequences))
        for one in findings
    ]


def entry_item(entry: CatalogueEntry) -> SplitEntry:
    return SplitEntry(
        sequence_id=entry.id,
        name=entry.name,
        environment=entry.environment,
        illumination=entry.illumination,
        daylight=entry.half,
        region=entry.region,
        frames=entry.frames,
        duration_s=entry.duration_s,
        distance_m=entry.distance_m,
        voxels=None if entry.voxels is None else VoxelsItem(**dict(zip(CLASSES, entry.voxels, strict=True))),
    )


def _assigned(split: Split, seen: tuple[CatalogueEntry, ...]) -> dict[str, list[SplitEntry]]:
    return {part: [entry_item(entry) for entry in seen if entry.id in {*ids}] for part, ids in split.parts.items()}


def _ids(split: Split) -> set[str]:
    return {one for ids in split.parts.values() for one in ids}


def _shares(shares: "PartShares") -> SharesItem:
    ratios = shares.class_ratios
    return SharesItem(
        sequences=shares.sequences,
        duration_ratio=shares.duration_ratio,
        class_ratios=None if ratios is None else VoxelRatios(**dict(zip(CLASSES, ratios, strict=True))),
    )
