"""The user's servers and the token for each: `credentials.json`, readable by its owner only.

**Conventions.** The file is in `STONE_CONFIG_HOME`, else `$XDG_CONFIG_HOME/stone`, else `~/.config/stone`. `STONE_URL`
and `STONE_TOKEN` take precedence. A URL has no path and no trailing slash.
"""

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import urlsplit

from stone_base.errors import Refused
from stone_files.atomic import atomic_file

FILE = "credentials.json"


@dataclass(frozen=True)
class Credentials:
    """The stored tokens; `default` is the server to use if none is named (empty: none)."""

    default: str = ""
    token_of: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Server:
    """A server's URL, and the token for it."""

    url: str
    token: str = field(repr=False)


def configuration_folder() -> Path:
    """Return the folder of this user's `stone` settings."""
    named = os.environ.get("STONE_CONFIG_HOME")
    if named:
        return Path(named)
    return Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config") / "stone"


def read_credentials() -> Credentials:
    """Return the stored credentials, empty if there is no file. Raises `bad_credentials_file`."""
    path = configuration_folder() / FILE
    if not path.exists():
        return Credentials()
    try:
        record = json.loads(path.read_text("utf-8"))
        servers = {str(url): str(known["token"]) for url, known in record["servers"].items()}
        return Credentials(str(record.get("default", "")), servers)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise Refused(
            "bad_credentials_file",
            f"{path} cannot be read as credentials: {type(error).__name__}: {error}; remove it and run "
            "`stone auth login`",
        ) from None


def remember(url: str, token: str, *, as_default: bool) -> None:
    """Store the token of a server. Raises `bad_credentials_file`."""
    known = read_credentials()
    default = url if as_default or not known.default else known.default
    _write(Credentials(default, {**known.token_of, url: token}))


def forget(url: str) -> None:
    """Delete the token of a server; no other server becomes the default. Raises `bad_credentials_file`."""
    known = read_credentials()
    left = {name: secret for name, secret in known.token_of.items() if name != url}
    _write(Credentials(known.default if known.default in left else "", left))


def stored_server(url: str | None) -> Server:
    """Return the named server, else the default, with its stored token; environment variables are ignored.

    Raises `not_signed_in`, `bad_url`, `bad_credentials_file`.
    """
    known = read_credentials()
    chosen = plain_url(url) if url else known.default
    if chosen not in known.token_of:
        raise Refused("not_signed_in", f"there is no stored token for {chosen or 'any server'}; nothing to sign out of")
    return Server(chosen, known.token_of[chosen])


def _write(credentials: Credentials) -> None:
    servers = {name: {"token": secret} for name, secret in credentials.token_of.items()}
    default = credentials.default
    configuration_folder().mkdir(parents=True, exist_ok=True, mode=0o700)
    with atomic_file(configuration_folder() / FILE) as staging:
        staging.chmod(0o600)
        staging.write_text(json.dumps({"default": default, "servers": servers}, indent=1) + "\n", "utf-8")


def choose_server(url: str | None = None) -> Server:
    """Return the server `url`, of `STONE_URL`, or of the last login, with its token.

    Raises `no_server`, `not_signed_in`, `bad_url`, `bad_credentials_file`.
    """
    token = os.environ.get("STONE_TOKEN", "")
    named = url or os.environ.get("STONE_URL", "")
    known = Credentials() if named and token else read_credentials()
    chosen = plain_url(named) if named else known.default
    if not chosen:
        raise Refused(
            "no_server", "no server configured; run `stone serve` here, `stone auth login URL`, or set STONE_URL"
        )
    token = token or known.token_of.get(chosen, "")
    if not token:
        raise Refused(
            "not_signed_in", f"there is no token for {chosen}; run `stone auth login {chosen}`, or set STONE_TOKEN"
        )
    return Server(chosen, token)


def plain_url(url: str) -> str:
    """Return the scheme, host and port of `url`; the default scheme is `http`. Raises `bad_url`."""
    typed = url if "://" in url else f"http://{url}"
    try:
        parts = urlsplit(typed)
        port = parts.port
    except ValueError:
        raise bad_url(url) from None
    if parts.scheme not in ("http", "https") or not parts.hostname or parts.username or parts.path.strip("/"):
        raise bad_url(url)
    host = f"[{parts.hostname}]" if ":" in parts.hostname else parts.hostname
    return f"{parts.scheme}://{host}" + (f":{port}" if port else "")


def is_local(url: str) -> bool:
    """Return whether the URL is of this machine."""
    host = urlsplit(url).hostname or ""
    return host in ("localhost", "::1") or host.startswith("127.")


def bad_url(url: str) -> Refused:
    return Refused("bad_url", f"{url!r} is not a server URL; expected for example http://127.0.0.1:8080")
