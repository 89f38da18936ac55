"""Visibility queries; administrators see everything.

**Conventions.** Other users' objects are looked up like missing ones, and both return 404. A deleted sequence is
visible to no one. A public sequence is in `shown_to` for all callers, and still its owner's. The ground truth of a
hidden phase is shown only to its owner, even if it is public.
"""

from functools import cache
from typing import TypeVar

from sqlalchemy import BindParameter, Select, and_, or_, select
from sqlalchemy.orm import InstrumentedAttribute, Session, aliased

from api.deps import Caller
from api.errors import NotFoundError
from services.domain.benchmarks.phases.phases import HIDDEN_PART, phase_named
from services.domain.benchmarks.teams.teams import is_member
from services.domain.datasets.catalogue import hidden_truths
from services.domain.datasets.queries import dataset_named
from services.domain.exports.requests import counting_labels
from services.domain.viewer.playback import PLAYBACK
from services.runtime.database.rows import KeptSelect, parameter
from services.runtime.orm import (
    Benchmark,
    CalibrationRow,
    Dataset,
    DatasetMember,
    Export,
    Job,
    LabelComparison,
    LabelledFrameRow,
    LabelSet,
    Phase,
    Recording,
    SequenceRow,
    SplitMember,
    SubmissionRow,
    Team,
    TeamMember,
)

Row = TypeVar("Row")

_NEWEST = (LabelSet.chosen_ns.desc(), LabelSet.id.desc())


def theirs(statement: Select[Row], caller: Caller, owner: InstrumentedAttribute[str]) -> Select[Row]:
    """Limit the statement to the caller's own rows unless the caller is an administrator."""
    return statement if caller.is_administrator else statement.where(owner == caller.user_id)


def sequences_of(caller: Caller) -> Select[SequenceRow]:
    return theirs(select(SequenceRow).where(SequenceRow.deleted_ns.is_(None)), caller, SequenceRow.owner_id)


def sequence_of(session: Session, caller: Caller, sequence_id: str) -> SequenceRow:
    """Return one of the caller's sequences. Raises `NotFoundError`."""
    return _only(session, sequences_of(caller).where(SequenceRow.id == sequence_id), "sequence", sequence_id)


def sequences_shown_to(caller: Caller) -> Select[SequenceRow]:
    """Select the caller's own sequences and the public ones."""
    return sequences_shown(None if caller.is_administrator else caller.user_id)


def sequences_shown(user_id: str | BindParameter[str] | None) -> Select[SequenceRow]:
    """Select as `sequences_shown_to`, for a user id or a bound parameter; None, an administrator, selects all."""
    everything = select(SequenceRow).where(SequenceRow.deleted_ns.is_(None))
    if user_id is None:
        return everything
    # A scalar subquery per public sequence: for EXISTS, the planner would build a table of all members for each list.
    hidden = hidden_truths().where(DatasetMember.sequence_id == SequenceRow.id).limit(1).scalar_subquery()
    is_shown = and_(SequenceRow.is_public, hidden.is_(None))
    return everything.where(or_(SequenceRow.owner_id == user_id, is_shown))


def shown_sequence(session: Session, caller: Caller, sequence_id: str) -> SequenceRow:
    """Return a sequence that the caller may view. Raises `NotFoundError`."""
    return _only(session, sequences_shown_to(caller).where(SequenceRow.id == sequence_id), "sequence", sequence_id)


def hiding(session: Session, sequence_id: str) -> str:
    """Return the reason why the labels of a sequence are hidden, or ''. The draft splits are read unchanged."""
    of_sequence = DatasetMember.sequence_id == sequence_id
    in_test = select(Dataset.name).join(DatasetMember).where(of_sequence, DatasetMember.part == HIDDEN_PART)
    if version := session.scalar(in_test.order_by(Dataset.id).limit(1)):
        return f"in test of version {version!r}"
    if session.scalar(hidden_truths().where(of_sequence).limit(1)):
        return "part of the ground truth of a hidden phase"
    drafted = select(SplitMember.part).where(SplitMember.sequence_id == sequence_id, SplitMember.part == HIDDEN_PART)
    return "in test of the draft splits" if session.scalar(drafted) else ""


def calibration_of(session: Session, caller: Caller, calibration_id: str) -> CalibrationRow:
    """Return one of the caller's calibrations. Raises `NotFoundError`."""
    mine = theirs(select(CalibrationRow), caller, CalibrationRow.owner_id)
    return _only(session, mine.where(CalibrationRow.id == calibration_id), "calibration", calibration_id)


def recording_of(session: Session, caller: Caller, sequence_id: str, recording_id: str) -> Recording:
    """Return a recording of one of the caller's sequences. Raises `NotFoundError`."""
    sequence = sequence_of(session, caller, sequence_id)
    of_sequence = select(Recording).where(Recording.sequence_id == sequence.id, Recording.id == recording_id)
    return _only(session, of_sequence, "recording", recording_id)


def export_of(session: Session, caller: Caller, sequence_id: str, export_id: str) -> Export:
    """Return an export of one of the caller's sequences. Raises `NotFoundError`."""
    sequence = sequence_of(session, caller, sequence_id)
    of_sequence = select(Export).where(Export.sequence_id == sequence.id, Export.id == export_id)
    return _only(session, of_sequence, "export", export_id)


def exports_shown_to(session: Session, caller: Caller, sequence_id: str) -> Select[Export]:
    """Select the exports of a sequence that the caller may view: all for its owner, the finished ones for others.

    A playback is its owner's: others get single files of it through the viewer. Raises `NotFoundError`.
    """
    sequence = shown_sequence(session, caller, sequence_id)
    everything = select(Export).where(Export.sequence_id == sequence.id)
    if caller.is_administrator or sequence.owner_id == caller.user_id:
        return everything
    return everything.where(Export.finished_ns.is_not(None), Export.format != PLAYBACK)


def readable_export(session: Session, caller: Caller, sequence_id: str, export_id: str) -> Export:
    """Return an export that the caller may read. Raises `NotFoundError`."""
    shown = exports_shown_to(session, caller, sequence_id).where(Export.id == export_id)
    return _only(session, shown, "export", export_id)


def label_comparison_of(session: Session, caller: Caller, sequence_id: str, comparison_id: str) -> LabelComparison:
    """Return a comparison of one of the caller's sequences. Raises `NotFoundError`."""
    sequence = sequence_of(session, caller, sequence_id)
    of_sequence = select(LabelComparison).where(LabelComparison.sequence_id == sequence.id)
    return _only(session, of_sequence.where(LabelComparison.id == comparison_id), "label comparison", comparison_id)


def label_set_of(session: Session, caller: Caller, sequence_id: str, label_set_id: str) -> LabelSet:
    """Return a label set of one of the caller's sequences. Raises `NotFoundError`."""
    sequence = sequence_of(session, caller, sequence_id)
    of_sequence = select(LabelSet).where(LabelSet.sequence_id == sequence.id)
    return _only(session, of_sequence.where(LabelSet.id == label_set_id), "label set", label_set_id)


def job_of(session: Session, caller: Caller, job_id: str) -> Job:
    """Return one of the caller's jobs. Raises `NotFoundError`."""
    return _only(session, theirs(select(Job), caller, Job.owner_id).where(Job.id == job_id), "job", job_id)


def labels_of(session: Session, sequence_id: str) -> LabelSet | None:
    """Return the active labels, or None."""
    return counting_labels(session, sequence_id)


def newest_label_set(session: Session, sequence_id: str) -> LabelSet:
    """Return the active labels. Raises `NotFoundError` if there are none."""
    return _known(labels_of(session, sequence_id), "label set of sequence", sequence_id)


def frame_of(session: Session, caller: Caller, token: str) -> tuple[LabelledFrameRow, LabelSet]:
    """Return the frame in the newest label set of its sequence; if several sequences have it, the newest labels.

    Tokens are made of the sequence's name and the stamp, so two owners may have the same one. Raises `NotFoundError`.
    """
    other = aliased(LabelSet)
    newest = (
        select(other.id)
        .where(other.sequence_id == LabelSet.sequence_id)
        .order_by(other.chosen_ns.desc(), other.id.desc())
        .limit(1)
        .scalar_subquery()
    )
    frames = (
        select(LabelledFrameRow, LabelSet)
        .join(LabelSet, LabelSet.id == LabelledFrameRow.label_set_id)
        .join(SequenceRow, SequenceRow.id == LabelSet.sequence_id)
        .where(LabelledFrameRow.token == token, LabelSet.id == newest, SequenceRow.deleted_ns.is_(None))
        .order_by(*_NEWEST, LabelledFrameRow.ordinal)
        .limit(1)
    )
    shown = sequences_shown_to(caller).with_only_columns(SequenceRow.id)
    row = session.execute(frames.where(SequenceRow.id.in_(shown))).one_or_none()
    return _known(row, "frame", token)


def dataset_of(session: Session, name: str) -> Dataset:
    """Return a version of the dataset, visible to all users. Raises `NotFoundError`."""
    return _known(dataset_named(session, name), "dataset version", name)


def benchmarks_of(caller: Caller) -> Select[Benchmark]:
    """Select all benchmarks for signed-in users, the public ones for a visitor."""
    return select(Benchmark).where(Benchmark.is_public) if caller.is_visitor else select(Benchmark)


def benchmark_of(session: Session, caller: Caller, name: str) -> Benchmark:
    """Return a benchmark that the caller may view. Raises `NotFoundError`."""
    return _only(session, benchmarks_of(caller).where(Benchmark.name == name), "benchmark", name)


def phase_at(session: Session, caller: Caller, benchmark: str, phase: str) -> Phase:
    """Return a phase by its names. Raises `NotFoundError`."""
    named_phase = phase_named(session, benchmark_of(session, caller, benchmark).name, phase)
    return _known(named_phase, "phase", f"{benchmark}/{phase}")


def phase_id_at(session: Session, caller: Caller, benchmark: str, phase: str) -> str:
    """Return the id of the phase as `phase_at`, by a cached statement. Raises `NotFoundError`."""
    rows = _phase_ids(caller.is_visitor).rows(session, {"benchmark": benchmark, "phase": phase})
    return str(rows[0].id) if rows else phase_at(session, caller, benchmark, phase).id


@cache
def _phase_ids(is_visitor: bool) -> KeptSelect:
    named = (Benchmark.name == parameter("benchmark"), Phase.name == parameter("phase"))
    phases = select(Phase.id).join(Benchmark, Benchmark.id == Phase.benchmark_id).where(*named)
    return KeptSelect(phases.where(Benchmark.is_public) if is_visitor else phases)


def phase_of(session: Session, phase_id: str) -> Phase:
    """Return a phase by its id. Raises `NotFoundError`."""
    return _known(session.get(Phase, phase_id), "phase", phase_id)


def teams_of(caller: Caller) -> Select[Team]:
    """Select the caller's teams; for administrators all teams."""
    own = select(TeamMember.team_id).where(TeamMember.user_id == caller.user_id)
    return select(Team) if caller.is_administrator else select(Team).where(Team.id.in_(own))


def team_of(session: Session, caller: Caller, team_id: str) -> Team:
    """Return one of the caller's teams. Raises `NotFoundError`."""
    return _only(session, teams_of(caller).where(Team.id == team_id), "team", team_id)


def member_team_of(session: Session, caller: Caller, team_id: str) -> Team:
    """Return a team that the caller may act for; administrators cannot act for other teams. Raises `NotFoundError`."""
    team = session.get(Team, team_id) if is_member(session, team_id, caller.user_id) else None
    return _known(team, "team", team_id)


def submissions_of(caller: Caller) -> Select[SubmissionRow]:
    """Select the submissions of the caller's teams; for administrators all submissions."""
    own = select(TeamMember.team_id).where(TeamMember.user_id == caller.user_id)
    submissions = select(SubmissionRow)
    return submissions if caller.is_administrator else submissions.where(SubmissionRow.team_id.in_(own))


def submission_of(session: Session, caller: Caller, submission_id: str) -> SubmissionRow:
    """Return a submission of one of the caller's teams. Raises `NotFoundError`."""
    return _only(session, submissions_of(caller).where(SubmissionRow.id == submission_id), "submission", submission_id)


def _only(session: Session, statement: Select[Row], kind: str, subject_id: str) -> Row:
    return _known(session.scalars(statement).one_or_none(), kind, subject_id)


def _known(found: Row | None, kind: str, subject_id: str) -> Row:
    if found is None:
        raise NotFoundError(kind, subject_id)
    return found
