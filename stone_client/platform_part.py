"""The platform beside the client: its commands where it is installed, and a refusal that says what to install.

**Conventions.** Nothing of the platform is imported by name, for the client is installed without it; `stone_local`
is looked up when it is asked for. An installation that is there and broken keeps its own traceback.
"""

from collections.abc import Callable, Sequence
from importlib import import_module
from importlib.util import find_spec
from typing import Any, NoReturn

import typer

from stone_base.errors import Refused
from stone_client.lazy_commands import Place
from stone_client.streams import WANTS_JSON

PACKAGE = "stone_local"
PLATFORM_COMMANDS = (
    "simulate", "inspect", "calibration", "recover", "label", "export", "check", "ceiling",
    "model", "demo", "serve",
)  # fmt: skip


def is_platform_installed() -> bool:
    return find_spec(PACKAGE) is not None


def platform_places() -> Sequence[Place]:
    """Return the places of the platform's commands and groups; none if it is not installed."""
    if not is_platform_installed():
        return ()
    found: Sequence[Place] = import_module(f"{PACKAGE}.registry").COMMANDS
    return found


def platform_module(name: str, command: str) -> Any:
    """A module of the platform that `command` needs. Raises `platform_not_installed`."""
    if not is_platform_installed():
        raise platform_not_installed(command)
    return import_module(f"{PACKAGE}.{name}")


def add_refusals(app: typer.Typer) -> None:
    """Commands of the platform's names that refuse whatever they are asked, and that no help lists."""
    for name in PLATFORM_COMMANDS:
        words = {"ignore_unknown_options": True, "allow_extra_args": True, "help_option_names": []}
        app.command(name, hidden=True, context_settings=words)(_refusal_of(name))


def _refusal_of(name: str) -> Callable[[typer.Context], NoReturn]:
    def refuse_it(context: typer.Context) -> NoReturn:
        context.find_root().meta[WANTS_JSON] = "--json" in context.args
        raise platform_not_installed(name)

    return refuse_it


def platform_not_installed(command: str) -> Refused:
    return Refused(
        "platform_not_installed",
        f"`stone {command}` requires the platform, but only its client is installed; in a checkout of the platform "
        f"run `make install`, then `.venv/bin/stone {command}`",
    )
