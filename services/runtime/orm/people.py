"""ORM models of users, tokens, browser sessions and teams. Secrets are stored as hashes only."""

from sqlalchemy import JSON, ForeignKey, String
from sqlalchemy.orm import Mapped, mapped_column, relationship

from services.runtime.orm.base import Base, Id, Ns, new_id, now_ns


class User(Base):
    """`role` is administrator, curator or participant; `password_hash` (argon2id) is empty without a password."""

    __tablename__ = "users"
    id: Mapped[Id] = mapped_column(primary_key=True, default=new_id)
    name: Mapped[str] = mapped_column(String(64), unique=True)
    role: Mapped[str] = mapped_column(String(16))
    password_hash: Mapped[str] = mapped_column(String(256), default="")
    is_active: Mapped[bool] = mapped_column(default=True)
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)


class Token(Base):
    """`scopes` lists read, upload, submit, admin, account; `secret_hash` is the sha256 of 32 random bytes in base64url.

    `parent_id` is the token that created it, and ends with it; null if a browser or the platform created it.
    """

    __tablename__ = "tokens"
    id: Mapped[Id] = mapped_column(primary_key=True, default=new_id)
    user_id: Mapped[Id] = mapped_column(ForeignKey("users.id", ondelete="CASCADE"), index=True)
    name: Mapped[str] = mapped_column(String(64))
    secret_hash: Mapped[str] = mapped_column(String(64), unique=True)
    scopes: Mapped[list[str]] = mapped_column(JSON)
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)
    expires_ns: Mapped[Ns] = mapped_column(index=True)
    used_ns: Mapped[Ns | None]
    parent_id: Mapped[Id | None] = mapped_column(ForeignKey("tokens.id", ondelete="CASCADE"), index=True)
    user: Mapped[User] = relationship(lazy="joined")


class WebSession(Base):
    """A signed-in browser: the cookie's hash, and the CSRF token that unsafe requests must repeat.

    `used_ns` is written at most once a minute.
    """

    __tablename__ = "web_sessions"
    id: Mapped[Id] = mapped_column(primary_key=True, default=new_id)
    user_id: Mapped[Id] = mapped_column(ForeignKey("users.id", ondelete="CASCADE"), index=True)
    secret_hash: Mapped[str] = mapped_column(String(64), unique=True)
    csrf_token: Mapped[str] = mapped_column(String(64))
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)
    expires_ns: Mapped[Ns] = mapped_column(index=True)
    used_ns: Mapped[Ns] = mapped_column(default=now_ns, index=True)
    user: Mapped[User] = relationship(lazy="joined")


class FailedSignInRow(Base):
    """Wrong passwords for a name or from an address; `key` is the sha256 of the name or address."""

    __tablename__ = "sign_in_guesses"
    key: Mapped[str] = mapped_column(String(64), primary_key=True)
    failures: Mapped[int] = mapped_column(default=0)
    failed_ns: Mapped[Ns] = mapped_column(index=True)
    blocked_until_ns: Mapped[Ns] = mapped_column(default=0)


class SignInAddress(Base):
    """An address from which a user signed in; `key` is the sha256 of name and address."""

    __tablename__ = "sign_in_addresses"
    key: Mapped[str] = mapped_column(String(64), primary_key=True)
    user_id: Mapped[Id] = mapped_column(ForeignKey("users.id", ondelete="CASCADE"), index=True)
    used_ns: Mapped[Ns] = mapped_column(default=now_ns, index=True)


class Team(Base):
    __tablename__ = "teams"
    id: Mapped[Id] = mapped_column(primary_key=True, default=new_id)
    name: Mapped[str] = mapped_column(String(64), unique=True)
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)


class TeamMember(Base):
    __tablename__ = "team_members"
    team_id: Mapped[Id] = mapped_column(ForeignKey("teams.id", ondelete="CASCADE"), primary_key=True)
    user_id: Mapped[Id] = mapped_column(ForeignKey("users.id", ondelete="CASCADE"), primary_key=True)
    is_owner: Mapped[bool] = mapped_column(default=False)


class TeamInvitation(Base):
    """A single-use invitation to a team; the row contains the sha256 of its secret."""

    __tablename__ = "team_invitations"
    id: Mapped[Id] = mapped_column(primary_key=True, default=new_id)
    team_id: Mapped[Id] = mapped_column(ForeignKey("teams.id", ondelete="CASCADE"), index=True)
    secret_hash: Mapped[str] = mapped_column(String(64), unique=True)
    created_by: Mapped[Id] = mapped_column(ForeignKey("users.id"))
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)
    expires_ns: Mapped[Ns] = mapped_column(index=True)
    used_by: Mapped[Id | None] = mapped_column(ForeignKey("users.id"))
    used_ns: Mapped[Ns | None]


# ORM models of sign-in: identities at a provider of OpenID Connect, and programs that wait for an approval.


class ExternalIdentity(Base):
    """A user's identity at a provider; `key` is the sha256 of issuer and subject."""

    __tablename__ = "external_identities"
    key: Mapped[str] = mapped_column(String(64), primary_key=True)
    issuer: Mapped[str] = mapped_column(String(500))
    subject: Mapped[str] = mapped_column(String(255))
    user_id: Mapped[Id] = mapped_column(ForeignKey("users.id", ondelete="CASCADE"), index=True)
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)
    used_ns: Mapped[Ns] = mapped_column(default=now_ns)
    user: Mapped[User] = relationship(lazy="joined")


class DeviceGrant(Base):
    """A program that waits for a user's approval in a browser (RFC 8628); both codes are stored as their sha256.

    `name` and `address` identify the program. `scopes` are the requested scopes, and after the approval by `user_id`
    the token's scopes. The row is deleted when the token is fetched, or with `session_id`, the browser session that
    approved it.
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
    session_id: Mapped[Id | None] = mapped_column(ForeignKey("web_sessions.id", ondelete="CASCADE"), index=True)
