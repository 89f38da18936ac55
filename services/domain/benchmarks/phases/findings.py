"""Warnings about a phase whose hidden labels are visible elsewhere.

**Conventions.** A sequence's labels are public for good once a version has the sequence in train or val, or its owner
made it public. They are hidden while a version has the sequence in test. One sequence may be public and hidden, in two
versions.
"""

from collections.abc import Iterator

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from services.domain.benchmarks.phases.phases import HIDDEN_PART
from services.runtime.orm import DatasetMember, Phase, SequenceRow
from stone.findings import Finding
from stone_base.counts import counted


def findings_of(session: Session, phase: Phase) -> tuple[Finding, ...]:
    """Return warnings about the secrecy of the phase's ground truth."""
    return tuple(_findings(session, phase))


def _findings(session: Session, phase: Phase) -> Iterator[Finding]:
    of_phase = select(DatasetMember.sequence_id)
    own = of_phase.where(DatasetMember.dataset_id == phase.dataset_id, DatasetMember.part == phase.part)
    members = select(func.count(func.distinct(DatasetMember.sequence_id))).where(DatasetMember.sequence_id.in_(own))
    total = counted(session.scalar(members) or 0, "sequence")
    if phase.is_hidden and (public := session.scalar(members.where(DatasetMember.part != HIDDEN_PART))):
        sentence = f"{public} of {total} are in train or val of a published version; their labels may be known"
        yield Finding("labels_are_public", "warning", "", sentence)
    shown = select(func.count()).select_from(SequenceRow).where(SequenceRow.published_ns.is_not(None))
    if phase.is_hidden and (public := session.scalar(shown.where(SequenceRow.id.in_(own)))):
        sentence = f"{public} of {total} are or were public on their own; their labels may have been downloaded"
        yield Finding("labels_were_public", "warning", "", sentence)
    if not phase.is_hidden and (hidden := session.scalar(members.where(DatasetMember.part == HIDDEN_PART))):
        sentence = (
            f"{hidden} of {total} are in test of another version; this phase reveals labels that the other version "
            "hides"
        )
        yield Finding("labels_are_hidden_elsewhere", "warning", "", sentence)
