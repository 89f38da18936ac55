"""Which servers this user knows, and the token for each: `credentials.json`, readable by its owner only.

**Conventions.** It lies in `STONE_CONFIG_HOME`, else `$XDG_CONFIG_HOME/stone`, else `~/.config/stone`. `STONE_URL` and
`STONE_TOKEN` come before what is in it. A URL has no path and no slash at its end.
"""

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import urlsplit

from stone_client.errors import BadCredentialsFileError, BadUrlError, NoServerError, NotSignedInError
from stone_files.atomic import atomic_file

FILE = "credentials.json"


@dataclass(frozen=True)
class Credentials:
    """`default` is the server that is meant where none is named; empty: none."""

    default: str = ""
    token_of: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Server:
    """A server's URL, and the token for it."""

    url: str
    token: str = field(repr=False)


def configuration_folder() -> Path:
    """The folder of this user's `stone` settings."""
    named = os.environ.get("STONE_CONFIG_HOME")
    if named:
        return Path(named)
    return Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config") / "stone"


def read_credentials() -> Credentials:
    """The stored credentials; none where there is no file. Raises `BadCredentialsFileError`."""
    path = configuration_folder() / FILE
    if not path.exists():
        return Credentials()
    try:
        record = json.loads(path.read_text("utf-8"))
        servers = {str(url): str(known["token"]) for url, known in record["servers"].items()}
        return Credentials(str(record.get("default", "")), servers)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise BadCredentialsFileError(path, f"{type(error).__name__}: {error}") from None


def remember(url: str, token: str, *, as_default: bool) -> None:
    """Keep the token of a server. Raises `BadCredentialsFileError`."""
    known = read_credentials()
    default = url if as_default or not known.default else known.default
    servers = {name: {"token": secret} for name, secret in {**known.token_of, url: token}.items()}
    configuration_folder().mkdir(parents=True, exist_ok=True, mode=0o700)
    with atomic_file(configuration_folder() / FILE) as staging:
        staging.chmod(0o600)
        staging.write_text(json.dumps({"default": default, "servers": servers}, indent=1) + "\n", "utf-8")


def choose_server(url: str | None = None) -> Server:
    """The server named here, by `STONE_URL`, or remembered, with its token.

    Raises `NoServerError`, `NotSignedInError`, `BadUrlError`, `BadCredentialsFileError`.
    """
    token = os.environ.get("STONE_TOKEN", "")
    named = url or os.environ.get("STONE_URL", "")
    known = Credentials() if named and token else read_credentials()
    chosen = plain_url(named) if named else known.default
    if not chosen:
        raise NoServerError
    token = token or known.token_of.get(chosen, "")
    if not token:
        raise NotSignedInError(chosen)
    return Server(chosen, token)


def plain_url(url: str) -> str:
    """Scheme, host and port of what was typed; `http` where it names no scheme. Raises `BadUrlError`."""
    typed = url if "://" in url else f"http://{url}"
    try:
        parts = urlsplit(typed)
        port = parts.port
    except ValueError:
        raise BadUrlError(url) from None
    if parts.scheme not in ("http", "https") or not parts.hostname or parts.username or parts.path.strip("/"):
        raise BadUrlError(url)
    host = f"[{parts.hostname}]" if ":" in parts.hostname else parts.hostname
    return f"{parts.scheme}://{host}" + (f":{port}" if port else "")


def is_local(url: str) -> bool:
    """Whether the URL is of this very machine."""
    host = urlsplit(url).hostname or ""
    return host in ("localhost", "::1") or host.startswith("127.")
