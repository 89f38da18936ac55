"""Users, tokens and browser sessions as response bodies, without any secret."""

from dataclasses import dataclass

from sqlalchemy import Select, select
from sqlalchemy.orm import Session

from api.errors import NotFoundError
from api.paging import Page, PageQuery, page
from api.schemas.people import BrowserItem, TokenItem, UserItem
from api.schemas.sign_in import ProviderItem, SignInWays
from services.runtime.access.storage_quota import balance
from services.runtime.orm import Token, User, WebSession
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.settings import Settings
from services.runtime.uploads.creation import owner_limit_bytes
from services.runtime.uploads.rows import UploadOwner

TO_PROVIDER = "/api/v1/sign-in/oidc"
"""The path that a browser opens to sign in with the provider."""


@dataclass(frozen=True)
class StorageUsage:
    """Bytes that a user has stored or under way, and how many they may have."""

    used_bytes: int
    limit_bytes: int


def sign_in_ways(settings: Settings) -> SignInWays:
    """Return the ways to sign in."""
    title = settings.oidc.shown_title
    provider = ProviderItem(title=title, path=TO_PROVIDER) if settings.oidc.issuer else None
    return SignInWays(passwords=settings.api.passwords, provider=provider)


def user_item(row: User) -> UserItem:
    return UserItem.of(row, has_password=bool(row.password_hash))


def user_of(session: Session, user_id: str, is_locked: bool = False) -> User:
    """Return the user. Raises `NotFoundError`."""
    user = session.get(User, user_id, with_for_update=is_locked)
    if user is None:
        raise NotFoundError("user", user_id)
    return user


def users_page(session: Session, query: PageQuery, name: str | None, role: str | None) -> Page[UserItem]:
    """Return users, newest first, filtered by part of the `name` and by `role` if given."""
    matching: Select[User] = select(User)
    if name:
        matching = matching.where(User.name.contains(name.lower(), autoescape=True))
    if role:
        matching = matching.where(User.role == role)
    return page(session, matching, User.id.desc(), query).shown(user_item)


def tokens_page(session: Session, query: PageQuery, user_id: str) -> Page[TokenItem]:
    """Return the tokens of a user, newest first."""
    return page(session, select(Token).where(Token.user_id == user_id), Token.id.desc(), query).shown(TokenItem.of)


def browsers_of(session: Session, user_id: str, current_id: str) -> list[BrowserItem]:
    """Return the browsers in which a user is signed in, newest first; `current_id` is that of the calling browser, or
    ''.
    """
    theirs = select(WebSession).where(WebSession.user_id == user_id, WebSession.expires_ns > now_ns())
    return [
        BrowserItem.of(row, is_current=row.id == current_id)
        for row in session.scalars(theirs.order_by(WebSession.id.desc()))
    ]


def storage_of(platform: Platform, session: Session, user: User) -> StorageUsage:
    """Return the user's storage: used bytes and quota."""
    limit_bytes = owner_limit_bytes(
        platform, UploadOwner(user.id, user.role == "administrator", user.role == "participant")
    )
    return StorageUsage(balance(session, user.id), limit_bytes)
