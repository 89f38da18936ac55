"""Ending credentials covers every table that holds a secret, and only one module creates credentials."""

import ast
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from sqlalchemy import select
from sqlalchemy.orm import Session

from services.runtime.access import device_grants, issuing, passwords, users
from services.runtime.access.ending import end_all, end_browsers
from services.runtime.access.erasure import erase_user
from services.runtime.access.issuing import TokenRequest, authority_for
from services.runtime.orm import Base, DeviceGrant, EmailAddress, Team, TeamInvitation, Token, User, WebSession
from services.runtime.platform import Platform

ROOT = Path(__file__).parents[4]
NO_WAY_IN = {
    "users.password_hash": "the password stays where it is not changed; shut out, it opens nothing",
    "webhooks.secret": "it signs what is sent, and opens nothing here",
}
"""Columns with a secret that ending does not touch, and the reasons."""
BROWSERS = {"web_sessions", "device_grants"}
ALL = {*BROWSERS, "tokens", "email_addresses", "team_invitations"}
WAYS: dict[str, tuple[Callable[[Session, User], object], set[str]]] = {
    "revoked by an administrator": (lambda session, user: end_all(session, user.id), ALL),
    "shut out": (lambda session, user: users.change_user(session, user, None, is_active=False), ALL),
    "erased": (erase_user, ALL),
    "a new password": (
        lambda session, user: users.change_password(session, user, passwords.hash_password("another horse, a battery")),
        BROWSERS,
    ),
    "signed out elsewhere": (lambda session, user: end_browsers(session, user.id), BROWSERS),
}


def secret_columns() -> set[str]:
    """Return all columns whose names mark a secret or its hash."""
    columns = (column for table in Base.metadata.sorted_tables for column in table.columns)
    return {str(one) for one in columns if one.name.endswith("_hash") or "secret" in one.name}


def give_everything(session: Session, user: User) -> None:
    """Create one credential of each kind, and one of each row that can become a credential."""
    authority = authority_for(user, 600.0)
    issuing.open_session(session, authority)
    issuing.issue_token(session, authority, TokenRequest("laptop", frozenset({"read"})))
    codes = device_grants.begin_grant(session, device_grants.DeviceRequest("program", "here", ("read",)))
    grant = device_grants.find_waiting(session, codes.user_code)
    assert grant is not None
    approver = session.scalars(select(WebSession.id).where(WebSession.user_id == user.id)).one()
    device_grants.approve(grant, authority, approver)
    team = Team(name=f"team of {user.name}")
    session.add_all([team, EmailAddress(user_id=user.id, address="a@example.org", secret_hash="e" + user.id)])
    session.flush()
    session.add(TeamInvitation(team_id=team.id, secret_hash="i" + user.id, created_by=user.id, expires_ns=2**62))
    session.flush()


def standing(session: Session, user_id: str) -> set[str]:
    """Return the tables that hold a working credential of the user."""
    of_user = (Token.user_id, WebSession.user_id, DeviceGrant.user_id, TeamInvitation.created_by)
    held = {one.class_.__tablename__ for one in of_user if session.scalars(select(one).where(one == user_id)).all()}
    mailed = select(EmailAddress).where(EmailAddress.user_id == user_id, EmailAddress.secret_hash != "")
    return held | ({"email_addresses"} if session.scalars(mailed).all() else set())


def test_every_table_with_a_secret_is_one_that_ending_walks() -> None:
    tables = {name.partition(".")[0] for name in secret_columns() - set(NO_WAY_IN)}
    assert tables == ALL, (
        "end the new secret in `ending` and give one in `give_everything`, or name why it opens nothing"
    )
    assert set(NO_WAY_IN) <= secret_columns()


@pytest.mark.parametrize("way", WAYS)
def test_each_way_ends_its_credentials_and_nobody_elses(platform_on: Platform, way: str) -> None:
    end, ended = WAYS[way]
    with platform_on.database.transaction() as session:
        ada, ben = (users.create_user(session, name, "curator") for name in ("ada", "ben"))
        for one in (ada, ben):
            give_everything(session, one)
        assert standing(session, ada.id) == ALL
    with platform_on.database.transaction() as session:
        end(session, session.get_one(User, ada.id))
    with platform_on.database.reading() as session:
        assert standing(session, ada.id) == ALL - ended
        assert standing(session, ben.id) == ALL


def test_one_module_makes_credentials() -> None:
    makers = {path for path in product_files() if makes_credentials(path)}
    assert makers == {ROOT / "services/runtime/access/issuing.py"}


def product_files() -> Iterator[Path]:
    for folder in ("api", "services", "stone_local", "web", "testing", "benchmarks", "chaos"):
        yield from (path for path in (ROOT / folder).rglob("*.py") if "node_modules" not in path.parts)


def makes_credentials(path: Path) -> bool:
    """Return whether the module constructs a row of a token or session, or inserts it by a statement."""
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if not isinstance(node, ast.Call):
            continue
        called = ast.unparse(node.func).rpartition(".")[2]
        rows = {ast.unparse(one).rpartition(".")[2] for one in node.args}
        if called in ("Token", "WebSession") or ("insert" in called and rows & {"Token", "WebSession"}):
            return True
    return False
