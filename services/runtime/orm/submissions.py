"""ORM models of submissions, their scores, scoring quotas and alarms.

**Conventions.** `state` is draft, queued, scoring, then scored, valid, invalid, failed or cancelled; only
`services/domain/benchmarks/submissions/submissions.py` changes it, by compare-and-set. Withdrawal and hiding are
independent of the state. A score belongs to one evaluation version (a ground truth and a metric) and never changes.
"""

from typing import Any

from sqlalchemy import JSON, CheckConstraint, ForeignKey, Index, LargeBinary, String, Text, text
from sqlalchemy.orm import Mapped, mapped_column

from services.runtime.orm.base import Base, Bytes, Id, Ns, Record, new_id, now_ns, partial_index

IS_UNSCORED = "state IN ('valid', 'invalid', 'failed', 'cancelled')"


class PhaseTeam(Base):
    """The one team with which a user participates in a phase."""

    __tablename__ = "phase_teams"
    phase_id: Mapped[Id] = mapped_column(ForeignKey("phases.id", ondelete="CASCADE"), primary_key=True)
    user_id: Mapped[Id] = mapped_column(ForeignKey("users.id", ondelete="CASCADE"), primary_key=True)
    team_id: Mapped[Id] = mapped_column(ForeignKey("teams.id", ondelete="CASCADE"), index=True)


class SubmissionRow(Base):
    """A zip of predictions. `kind` is entry, baseline (shown, not ranked) or validation (checked, never scored).

    `modality` is a sum of C, L and R. `description` is the plain text of the method's page. `problems` are the
    validation's results. `blob_sha256` is set once the file is stored; the file may be deleted long after.
    """

    __tablename__ = "submissions"
    id: Mapped[Id] = mapped_column(primary_key=True, default=new_id)
    phase_id: Mapped[Id] = mapped_column(ForeignKey("phases.id"))
    team_id: Mapped[Id] = mapped_column(ForeignKey("teams.id"), index=True)
    user_id: Mapped[Id] = mapped_column(ForeignKey("users.id"), index=True)
    kind: Mapped[str] = mapped_column(String(16), default="entry")
    method: Mapped[str] = mapped_column(String(100))
    description: Mapped[str] = mapped_column(Text, default="")
    modality: Mapped[str] = mapped_column(String(8))
    state: Mapped[str] = mapped_column(String(16), default="draft")
    declared_sha256: Mapped[str] = mapped_column(String(64))
    size_bytes: Mapped[Bytes]
    upload_id: Mapped[Id | None] = mapped_column(ForeignKey("uploads.id"), unique=True)
    blob_sha256: Mapped[str | None] = mapped_column(ForeignKey("blobs.sha256"), index=True)
    job_id: Mapped[Id | None] = mapped_column(ForeignKey("jobs.id"), index=True)
    problems: Mapped[Record | None] = mapped_column(JSON)
    failure_code: Mapped[str] = mapped_column(String(64), default="")
    failure: Mapped[str] = mapped_column(String(2000), default="")
    revision: Mapped[int] = mapped_column(default=1)
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)
    finalized_ns: Mapped[Ns | None]
    settled_ns: Mapped[Ns | None]
    withdrawn_ns: Mapped[Ns | None]
    hidden_ns: Mapped[Ns | None]
    hidden_reason: Mapped[str] = mapped_column(String(512), default="")

    __table_args__ = (
        Index("ix_submissions_phase_state", "phase_id", "state"),
        Index("ix_submissions_state_settled", "state", "settled_ns"),
        Index("ix_submissions_settled", "settled_ns"),
        Index("ix_submissions_state_created", "state", "created_ns", "id"),
        partial_index("ix_submissions_purgeable", f"{IS_UNSCORED} AND upload_id IS NOT NULL", "settled_ns"),
        partial_index("ix_submissions_withdrawn", "upload_id IS NOT NULL", "state", "withdrawn_ns"),
    )


class Score(Base):
    """One submission against one ground truth by one metric.

    `confusions_sha256` names the stored counts by frame and ring, `spectra_sha256` the spectra that every interval and
    comparison uses (bootstrap replicates, if the metric's intervals are withdrawn). `content_sha256` is equal for equal
    predictions. Undefined ratios are null.
    """

    __tablename__ = "scores"
    id: Mapped[Id] = mapped_column(primary_key=True, default=new_id)
    submission_id: Mapped[Id] = mapped_column(ForeignKey("submissions.id", ondelete="CASCADE"))
    truth_id: Mapped[Id] = mapped_column(ForeignKey("ground_truths.id"), index=True)
    metric: Mapped[str] = mapped_column(String(32))
    signature: Mapped[str] = mapped_column(String(300))
    iou_occ: Mapped[float | None]
    iou_t: Mapped[float | None]
    iou_p: Mapped[float | None]
    iou_n: Mapped[float | None]
    miou: Mapped[float | None]
    record: Mapped[Record] = mapped_column(JSON)
    confusions_sha256: Mapped[str] = mapped_column(ForeignKey("blobs.sha256"), index=True)
    spectra_sha256: Mapped[str] = mapped_column(ForeignKey("blobs.sha256"), index=True)
    content_sha256: Mapped[str] = mapped_column(String(64), index=True)
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)

    __table_args__ = (
        Index("uq_scores_submission_truth_metric", "submission_id", "truth_id", "metric", unique=True),
        *(
            CheckConstraint(f"{name} IS NULL OR ({name} >= 0 AND {name} <= 1)", name=f"{name}_is_a_ratio")
            for name in ("iou_occ", "iou_t", "iou_p", "iou_n", "miou")
        ),
    )


class ScorePart(Base):
    """Counts of the frames [start, stop) of a submission, until all parts exist and are joined.

    `code_version` is the version of the code that counted them; empty before revision 0020.
    """

    __tablename__ = "score_parts"
    submission_id: Mapped[Id] = mapped_column(ForeignKey("submissions.id", ondelete="CASCADE"), primary_key=True)
    truth_id: Mapped[Id] = mapped_column(ForeignKey("ground_truths.id"), primary_key=True)
    start: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    stop: Mapped[int]
    counts: Mapped[bytes] = mapped_column(LargeBinary)
    problems: Mapped[Record] = mapped_column(JSON)
    code_version: Mapped[str] = mapped_column(String(64), default="", server_default=text("''"))


class ScoringEntry(Base):
    """`amount` scorings used (positive) or returned (negative) by a team in a phase; the balance is the sum.

    Without a submission it is a grant of an administrator. Rows are only added.
    """

    __tablename__ = "scoring_ledger"
    id: Mapped[Id] = mapped_column(primary_key=True, default=new_id)
    phase_id: Mapped[Id] = mapped_column(ForeignKey("phases.id"))
    team_id: Mapped[Id] = mapped_column(ForeignKey("teams.id"))
    submission_id: Mapped[Id | None] = mapped_column(ForeignKey("submissions.id"), index=True)
    amount: Mapped[int]
    reason: Mapped[str] = mapped_column(String(64))
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)

    __table_args__ = (Index("ix_scoring_ledger_phase_team", "phase_id", "team_id"),)


class Alarm(Base):
    """A fact for an administrator to check: equal content across teams, many near-equal entries of one team."""

    __tablename__ = "alarms"
    id: Mapped[Id] = mapped_column(primary_key=True, default=new_id)
    phase_id: Mapped[Id] = mapped_column(ForeignKey("phases.id", ondelete="CASCADE"), index=True)
    kind: Mapped[str] = mapped_column(String(32))
    subject: Mapped[str] = mapped_column(String(128))
    facts: Mapped[dict[str, Any]] = mapped_column(JSON, default=dict)
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)
    dismissed_ns: Mapped[Ns | None]

    __table_args__ = (Index("uq_alarms_phase_kind_subject", "phase_id", "kind", "subject", unique=True),)
