"""ORM models of sign-in: identities at a provider of OpenID Connect, and programs that wait for an approval."""

from sqlalchemy import JSON, ForeignKey, String
from sqlalchemy.orm import Mapped, mapped_column, relationship

from services.runtime.orm.base import Base, Id, Ns, new_id, now_ns
from services.runtime.orm.people import User


class ExternalIdentity(Base):
    """A user as a provider knows them; `key` is the sha256 of issuer and subject."""

    __tablename__ = "external_identities"
    key: Mapped[str] = mapped_column(String(64), primary_key=True)
    issuer: Mapped[str] = mapped_column(String(500))
    subject: Mapped[str] = mapped_column(String(255))
    user_id: Mapped[Id] = mapped_column(ForeignKey("users.id", ondelete="CASCADE"), index=True)
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)
    used_ns: Mapped[Ns] = mapped_column(default=now_ns)
    user: Mapped[User] = relationship(lazy="joined")


class DeviceGrant(Base):
    """A program that waits for somebody to approve it in a browser (RFC 8628); both codes are kept as their sha256.

    `name` and `address` say who asks. `scopes` are those that are asked for, and once `user_id` has approved it those
    that the token is to have. The row goes when the token is given out.
    """

    __tablename__ = "device_grants"
    id: Mapped[Id] = mapped_column(primary_key=True, default=new_id)
    device_hash: Mapped[str] = mapped_column(String(64), unique=True)
    user_hash: Mapped[str] = mapped_column(String(64), unique=True)
    name: Mapped[str] = mapped_column(String(64))
    address: Mapped[str] = mapped_column(String(64))
    scopes: Mapped[list[str]] = mapped_column(JSON)
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)
    expires_ns: Mapped[Ns] = mapped_column(index=True)
    polled_ns: Mapped[Ns] = mapped_column(default=0)
    is_denied: Mapped[bool] = mapped_column(default=False)
    user_id: Mapped[Id | None] = mapped_column(ForeignKey("users.id", ondelete="CASCADE"), index=True)
    user: Mapped[User | None] = relationship(lazy="joined")
