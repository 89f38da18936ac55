"""ORM models of exports and their packs."""

from sqlalchemy import ForeignKey, Index, String
from sqlalchemy.orm import Mapped, mapped_column

from services.runtime.orm.base import Base, Bytes, Id, Ns, new_id, now_ns


class Export(Base):
    """One label set in one format, since it was asked for; `job_id` makes it, or has made it.

    What is below `finished_ns` is set with it, in the transaction of the job's success. `recipe` is that of the label
    set, the format and the code version: what was exported once is not exported again.
    """

    __tablename__ = "exports"
    id: Mapped[Id] = mapped_column(primary_key=True, default=new_id)
    sequence_id: Mapped[Id] = mapped_column(ForeignKey("sequences.id", ondelete="CASCADE"))
    label_set_id: Mapped[Id] = mapped_column(ForeignKey("label_sets.id", ondelete="CASCADE"), index=True)
    job_id: Mapped[Id] = mapped_column(ForeignKey("jobs.id"))
    format: Mapped[str] = mapped_column(String(16))
    recipe: Mapped[str] = mapped_column(String(64))
    code_version: Mapped[str] = mapped_column(String(64))
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)
    finished_ns: Mapped[Ns | None]
    index_sha256: Mapped[str | None] = mapped_column(ForeignKey("blobs.sha256"), index=True)
    files: Mapped[int] = mapped_column(default=0)
    size_bytes: Mapped[Bytes] = mapped_column(default=0)
    tar_bytes: Mapped[Bytes] = mapped_column(default=0)
    tar_sha256: Mapped[str] = mapped_column(String(64), default="")
    zip_bytes: Mapped[Bytes] = mapped_column(default=0)
    zip_sha256: Mapped[str] = mapped_column(String(64), default="")

    __table_args__ = (Index("uq_exports_sequence_recipe", "sequence_id", "recipe", unique=True),)


class ExportPack(Base):
    """Files of an export one after another, as one blob; the export's index says where each lies in which pack."""

    __tablename__ = "export_packs"
    export_id: Mapped[Id] = mapped_column(ForeignKey("exports.id", ondelete="CASCADE"), primary_key=True)
    ordinal: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    blob_sha256: Mapped[str] = mapped_column(ForeignKey("blobs.sha256"), index=True)
    size_bytes: Mapped[Bytes]
