"""ORM model of comparisons of two label sets."""

from typing import Any

from sqlalchemy import JSON, ForeignKey, Index, String
from sqlalchemy.orm import Mapped, mapped_column

from services.runtime.orm.base import Base, Id, Ns, new_id, now_ns


class LabelComparison(Base):
    """Label sets A and B of a sequence held against each other, since it was asked for; `job_id` counts, or has.

    `record` is set with `finished_ns`, in the transaction of the job's success. Label sets never change, so one
    comparison of a pair by one code version is enough.
    """

    __tablename__ = "label_comparisons"
    id: Mapped[Id] = mapped_column(primary_key=True, default=new_id)
    sequence_id: Mapped[Id] = mapped_column(ForeignKey("sequences.id", ondelete="CASCADE"), index=True)
    a_id: Mapped[Id] = mapped_column(ForeignKey("label_sets.id", ondelete="CASCADE"))
    b_id: Mapped[Id] = mapped_column(ForeignKey("label_sets.id", ondelete="CASCADE"), index=True)
    job_id: Mapped[Id] = mapped_column(ForeignKey("jobs.id"))
    code_version: Mapped[str] = mapped_column(String(64))
    record: Mapped[dict[str, Any] | None] = mapped_column(JSON)
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)
    finished_ns: Mapped[Ns | None]

    __table_args__ = (Index("uq_label_comparisons_pair", "a_id", "b_id", "code_version", unique=True),)
