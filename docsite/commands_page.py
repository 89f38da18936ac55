"""The reference of the `stone` command, from its options: the output of `--help` on one page."""

from collections.abc import Iterator
from typing import Any

import click
from typer.main import get_command

from docsite.markdown import code, plain, table
from stone_client.command_tree import COMMANDS, PANELS
from stone_client.main import app

HEAD = """# Commands

The help of every command (`stone COMMAND --help`, or `-h`), on one page. A verb at the top works on local files
without a server; a noun groups the verbs for objects on a server. Exit codes: 0 success, 1 refused input (coded
findings on stderr, with `--json` also on stdout), 2 wrong usage, 130 and 143 interrupted.

- **Ids** are printed whole. Commands also take six or more digits of the beginning or end of an id, `latest` and
  `latest~1`; an ambiguous id is refused with its candidates.
- **Completion**: `stone --install-completion` installs completion for bash, zsh or fish.
- **Words of release 0.1**, such as `stone upload`, still run; each prints the new word on stderr.

| variable | |
|---|---|
| `STONE_URL` | The server, if `--server` is not given (default: the server of the last `stone auth login`). |
| `STONE_TOKEN` | The token for the server, instead of the stored one. |
| `STONE_CONFIG_HOME` | The folder of `credentials.json` (default: `$XDG_CONFIG_HOME/stone`, else `~/.config/stone`). |
| `STONE_QUIET`, `STONE_NO_PROGRESS` | Set to 1 for the effect of `--quiet` and `--no-progress`. |
| `NO_COLOR` | Print without colours. |
"""


def commands_page() -> str:
    """Return the page."""
    group = get_command(app)
    context = click.Context(group, info_name="stone")  # type: ignore[arg-type]
    known: dict[str, Any] = dict(group.commands)  # type: ignore[attr-defined]
    parts = [HEAD]
    for panel in PANELS:
        names = [command.word for command in COMMANDS if command.panel == panel]
        parts.append(f"## {panel}\n")
        parts += [part for name in names for part in _in_words(known[name], context, f"stone {name}")]
    return "\n".join(parts)


def _in_words(command: Any, context: click.Context, path: str) -> Iterator[str]:
    inside = getattr(command, "commands", None)
    if inside:
        for name, param in ((name, param) for name, param in inside.items() if not param.hidden):
            yield from _in_words(param, context, f"{path} {name}")
        return
    own = click.Context(command, info_name=path)
    usage = " ".join([path, *command.collect_usage_pieces(own)])
    yield f"### {path}\n\n{plain(command.help or '')}\n\n```\n{usage}\n```\n"
    shown = (param for param in command.get_params(own) if param.name != "help")
    yield table(("option", "", "default"), (_row(param, own) for param in shown))


def _row(one: Any, context: click.Context) -> tuple[str, str, str]:
    is_argument = one.param_type_name == "argument"
    name = one.display_name_raw if is_argument else ", ".join([*one.opts, *one.secondary_opts])
    typed = f"{name} {one.display_type_rich(context)}".strip()
    value = one.show_default if isinstance(one.show_default, str) else one.default
    is_shown = value is not None and value != [] and not isinstance(value, bool) and not callable(value)
    return code(typed), plain(one.help or ""), code(value) if is_shown else ""
