"""`stone auth login`: a token for a server."""

import sys
from typing import TYPE_CHECKING, Annotated

import typer

from stone_client.streams import JsonOption, echo_json

if TYPE_CHECKING:
    from stone_client.browser_sign_in import ShownCode

UrlArgument = Annotated[str, typer.Argument(metavar="[URL]", help="URL of the server (default scheme: http).")]
NameOption = Annotated[str | None, typer.Option(help="User name (default: prompt for it).")]
PasswordOption = Annotated[bool, typer.Option("--password-stdin", help="Read the password from stdin.")]
TokenOption = Annotated[
    bool, typer.Option("--token-stdin", help="Read a token from stdin, instead of name and password.")
]
BrowserOption = Annotated[
    bool, typer.Option("--browser", help="Show a code to approve in a browser, instead of name and password.")
]
AdminOption = Annotated[bool, typer.Option("--admin", help="Request a token with the scope admin.")]


def login(
    url: UrlArgument = "http://127.0.0.1:8080",
    name: NameOption = None,
    password_stdin: PasswordOption = False,
    token_stdin: TokenOption = False,
    browser: BrowserOption = False,
    admin: AdminOption = False,
    as_json: JsonOption = False,
) -> None:
    """Sign in to a server, and store its token in ~/.config/stone/credentials.json for the other commands.

    With --browser, or if the server uses a sign-in provider, the command shows a code to approve in a browser.
    """
    from stone_client.browser_sign_in import asks_for_browser, sign_in_by_browser
    from stone_client.credentials import plain_url
    from stone_client.sign_in import sign_in_by_password, sign_in_by_token

    if token_stdin and (password_stdin or name or admin):
        raise typer.BadParameter("a token already identifies you and its scopes", param_hint="--token-stdin")
    if browser and (token_stdin or password_stdin or name):
        raise typer.BadParameter("you identify yourself in the browser", param_hint="--browser")
    server = plain_url(url)
    if token_stdin:
        signed_in = sign_in_by_token(server, sys.stdin.readline().strip())
    elif (asks_for_browser(server) and not (name or password_stdin)) or browser:  # fails before any prompt
        signed_in = sign_in_by_browser(server, _show, as_administrator=admin)
    else:
        name = name or typer.prompt("Name", err=True)
        is_prompted = not password_stdin and sys.stdin.isatty()
        password = typer.prompt("Password", hide_input=True, err=True) if is_prompted else _line()
        if not password:
            raise typer.BadParameter("there is no terminal for a prompt, and stdin is empty", param_hint="password")
        signed_in = sign_in_by_password(server, name, password, as_administrator=admin)
    if as_json:
        echo_json(signed_in.as_record())
    else:
        typer.echo(f"{signed_in.name} ({signed_in.role}) at {signed_in.url}; scopes: {', '.join(signed_in.scopes)}")


def _show(code: "ShownCode") -> None:
    typer.echo(f"Open {code.url_with_code}\nand approve the code {code.user_code}; waiting …", err=True)


def _line() -> str:
    return sys.stdin.readline().rstrip("\n")
