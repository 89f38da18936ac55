"""First start of an embedded platform: the administrator account, and a token for this machine.

**Conventions.** The two secrets are in the data folder, readable by its owner only, who can also read the database
there. The password's file is written before its user, so a crash in between loses neither.
"""

import os
from dataclasses import dataclass
from pathlib import Path
from secrets import token_urlsafe

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.runtime.access.tokens import find, issue
from services.runtime.access.users import create_user
from services.runtime.orm import User
from services.runtime.platform import Platform
from services.runtime.settings import Settings

ADMINISTRATOR = "admin"
PASSWORD_FILE = "admin-password"
TOKEN_FILE = "local-token"
TOKEN_SCOPES = ("read", "upload", "submit")


@dataclass(frozen=True)
class FirstStartKeys:
    """`password` is empty unless the administrator was just created; `token` is the local command's."""

    name: str
    password: str
    token: str


def ensure_keys(platform: Platform) -> FirstStartKeys:
    """Create the administrator and the local token if there is no administrator or no valid token."""
    root = platform.settings.root
    password = ""
    with platform.database.transaction() as session:
        user = find_administrator(session)
        if user is None:
            password = _kept_secret(root / PASSWORD_FILE) or _keep(root / PASSWORD_FILE, token_urlsafe(15))
            user = create_user(session, ADMINISTRATOR, "administrator", password)
        secret = _kept_secret(root / TOKEN_FILE)
        if not secret or find(session, secret) is None:
            secret = issue(session, user, "this machine", TOKEN_SCOPES, platform.settings.api.token_s)
            _keep(root / TOKEN_FILE, secret)
        return FirstStartKeys(user.name, password, secret)


def first_password_file(settings: Settings) -> Path | None:
    """Return the file with the first administrator's password; None if it does not exist or passwords are off."""
    file = settings.root / PASSWORD_FILE
    return file if settings.api.passwords and file.exists() else None


def find_administrator(session: Session) -> User | None:
    """Return the first administrator, or None."""
    active = select(User).where(User.role == "administrator", User.is_active).order_by(User.id)
    return session.scalars(active.limit(1)).first()


def _kept_secret(path: Path) -> str:
    return path.read_text("utf-8").strip() if path.exists() else ""


def _keep(path: Path, secret: str) -> str:
    """Write a secret that only its owner may read; the file never has wider permissions."""
    staging = path.with_name(f".{path.name}.partial")
    staging.unlink(missing_ok=True)
    descriptor = os.open(staging, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600)
    with os.fdopen(descriptor, "w") as file:
        file.write(secret + "\n")
        file.flush()
        os.fsync(file.fileno())
    staging.replace(path)
    return secret
