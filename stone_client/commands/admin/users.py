"""`stone admin users`: list, add, change and delete accounts."""

import sys
from typing import Annotated, Any

import typer

from stone_base.errors import one_line
from stone_base.newer_python import StrEnum
from stone_client.commands.admin import RequiredReason
from stone_client.confirmation import DryRunOption, PermanentAct, YesOption, confirm
from stone_client.options import ServerOption
from stone_client.record_tables import echo_records
from stone_client.streams import JsonOption, echo_json

COLUMNS = {"name": "name", "role": "role", "active": "is_active", "password": "has_password", "since": "created_at"}


class Role(StrEnum):
    PARTICIPANT = "participant"
    CURATOR = "curator"
    ADMINISTRATOR = "administrator"


UserArgument = Annotated[str, typer.Argument(metavar="USER", help="A user's name or id.")]
RoleArgument = Annotated[Role, typer.Argument(metavar="ROLE", help="participant, curator or administrator.")]
PasswordOption = Annotated[bool, typer.Option("--password", help="Prompt for a password.")]
PasswordStdinOption = Annotated[bool, typer.Option("--password-stdin", help="Read the password from stdin.")]


def listed(
    role: Annotated[Role | None, typer.Option(metavar="ROLE", help="Only users with this role.")] = None,
    name: Annotated[str | None, typer.Option(metavar="TEXT", help="Only users with this text in the name.")] = None,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """List the users, newest first."""
    from stone_client.connection import administering

    query = {key: str(value) for key, value in (("role", role), ("name", name)) if value is not None}
    with administering(server) as api:
        users = list(api.pages("/admin/users", **query))
    echo_records("users", users, {**COLUMNS, "id": "id"}, as_json=as_json)


def add(
    name: Annotated[str, typer.Argument(metavar="NAME", help="The new user's name.")],
    role: Annotated[Role, typer.Option(metavar="ROLE", help="participant, curator or administrator.")],
    reason: RequiredReason,
    has_password: PasswordOption = False,
    password_stdin: PasswordStdinOption = False,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Add a user; without a password the user can sign in only with the platform's provider."""
    from stone_client.connection import administering

    body = {"name": name, "role": str(role), "reason": reason}
    if has_password or password_stdin:
        body["password"] = _password(is_from_stdin=password_stdin)
    with administering(server) as api:
        _echo(api.create("/admin/users", body), "added", as_json=as_json)


def set_role(
    user: UserArgument,
    role: RoleArgument,
    reason: RequiredReason,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Give a user another role."""
    _change(user, {"role": str(role), "reason": reason}, server, as_json=as_json)


def set_password(
    user: UserArgument,
    reason: RequiredReason,
    password_stdin: PasswordStdinOption = False,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Set a user's password, from a prompt or from stdin."""
    body = {"password": _password(is_from_stdin=password_stdin), "reason": reason}
    _change(user, body, server, as_json=as_json)


def reactivate(
    user: UserArgument, reason: RequiredReason, server: ServerOption = None, as_json: JsonOption = False
) -> None:
    """Let a deactivated user sign in again."""
    _change(user, {"is_active": True, "reason": reason}, server, as_json=as_json)


def deactivate(
    user: UserArgument,
    reason: RequiredReason,
    is_confirmed: YesOption = False,
    is_dry_run: DryRunOption = False,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Prevent a user from signing in, and revoke all tokens of the user permanently."""
    from stone_client.connection import administering
    from stone_client.server.admin.users import user_named

    with administering(server) as api:
        account = user_named(api, user)
        act = PermanentAct(f"deactivate {account['name']} ({account['id']})", "all tokens and sessions of the user end")
        confirm(act, {"user": dict(account)}, is_given=is_confirmed, is_dry_run=is_dry_run, as_json=as_json)
        answer = api.send("PATCH", f"/admin/users/{account['id']}", json={"is_active": False, "reason": reason})
        _echo(answer.json(), "deactivated", as_json=as_json)


def delete(
    user: UserArgument,
    reason: RequiredReason,
    is_confirmed: YesOption = False,
    is_dry_run: DryRunOption = False,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Delete an account permanently; the user's sequences and submissions stay, without a name."""
    from stone_client.connection import administering
    from stone_client.server.admin.users import user_named

    with administering(server) as api:
        account = user_named(api, user)
        effect = "name, password, tokens and sessions are lost; sequences and submissions stay, without a name"
        act = PermanentAct(f"delete {account['name']} ({account['id']})", effect)
        confirm(act, {"user": dict(account)}, is_given=is_confirmed, is_dry_run=is_dry_run, as_json=as_json)
        _echo(api.create(f"/admin/users/{account['id']}/erase", {"reason": reason}), "deleted", as_json=as_json)


def _change(user: str, body: dict[str, Any], server: str | None, *, as_json: bool) -> None:
    from stone_client.connection import administering
    from stone_client.server.admin.users import user_named

    with administering(server) as api:
        answer = api.send("PATCH", f"/admin/users/{user_named(api, user)['id']}", json=body)
    _echo(answer.json(), "changed", as_json=as_json)


def _password(*, is_from_stdin: bool) -> str:
    if is_from_stdin:
        return sys.stdin.readline().rstrip("\n")
    typed: str = typer.prompt("Password", hide_input=True, err=True)
    return typed


def _echo(user: dict[str, Any], act: str, *, as_json: bool) -> None:
    if as_json:
        echo_json(user)
    else:
        active = "" if user["is_active"] else ", not active"
        typer.echo(
            one_line(f"{act}: {user['name'] or 'a user without a name'} ({user['role']}{active}), id {user['id']}")
        )
