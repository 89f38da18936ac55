"""ORM model of upload parts in the store."""

from sqlalchemy import ForeignKey, String, text
from sqlalchemy.orm import Mapped, mapped_column

from services.runtime.orm.base import Base, Bytes, Id, partial_index

FIRST = text("offset_bytes = 0")


class UploadPartRow(Base):
    """A run of an upload's bytes, one object of the store that never changes; the runs of an upload leave no gap.

    Several uploads of an owner may share an object. Where it is that of a blob, `blob_sha256` keeps it.
    """

    __tablename__ = "upload_parts"
    upload_id: Mapped[Id] = mapped_column(ForeignKey("uploads.id", ondelete="CASCADE"), primary_key=True)
    offset_bytes: Mapped[Bytes] = mapped_column(primary_key=True, autoincrement=False)
    length_bytes: Mapped[Bytes]
    object_key: Mapped[str] = mapped_column(String(160), index=True)
    blob_sha256: Mapped[str | None] = mapped_column(ForeignKey("blobs.sha256"), index=True)

    __table_args__ = (partial_index("ix_upload_parts_first", "offset_bytes = 0", "upload_id", "offset_bytes"),)
