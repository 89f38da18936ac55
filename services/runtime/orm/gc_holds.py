"""ORM model of garbage collection holds."""

from sqlalchemy import String
from sqlalchemy.orm import Mapped, mapped_column

from services.runtime.orm.base import Base, Id, Ns, new_id


class GcHoldRow(Base):
    """While `until_ns`, by the database's clock, is to come, no object of the store is deleted.

    Whoever holds puts it off again and again; a holder that died is forgotten by itself.
    """

    __tablename__ = "gc_holds"
    id: Mapped[Id] = mapped_column(primary_key=True, default=new_id)
    reason: Mapped[str] = mapped_column(String(128))
    until_ns: Mapped[Ns] = mapped_column(index=True)
