"""The configuration reference, from the groups of `Settings`: every variable, its type and its default.

**Conventions.** A group's docstring explains its settings; a name contains its unit. Secrets are named, never shown.
"""

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from inspect import cleandoc, getdoc
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

from pydantic import SecretStr

from docsite.markdown import code, table
from services.runtime import settings as module
from services.runtime.settings import Settings
from services.runtime.settings_checks import BOUNDS

HEAD = """# Configuration

Every process (API, workers, sweeper, migrations) reads the same settings. This page is generated from
`services/runtime/settings.py`.

"""
REFUSED = """## What is refused

If a value is out of these bounds, the process exits at its start with `impossible_settings`. Further rules:

- `STONE_JOBS__HEARTBEAT_S` is less than a third of `STONE_JOBS__LEASE_S` and at least `STONE_JOBS__PROGRESS_S`.
- `STONE_STORE__S3_ENDPOINT` requires `STONE_STORE__S3_BUCKET`.
- `STONE_API__URL` begins with `http://` or `https://`.
- `STONE_OIDC__ISSUER` is https (http only on the same machine) and requires `STONE_OIDC__CLIENT_ID`.
- `STONE_API__PASSWORDS` off requires `STONE_OIDC__ISSUER` and `STONE_OIDC__ADMINISTRATORS`.
- `STONE_NOTIFICATIONS__SMTP_HOST` requires `STONE_NOTIFICATIONS__SENDER`, and a user with a password requires TLS.

A variable or secret file whose name looks like a setting but is not a setting is refused with the nearest known name
(`unknown_setting`).
"""
SIGNS = (("ge", "≥"), ("gt", ">"), ("le", "≤"), ("lt", "<"))
UNITS = ((3600.0 * 24, "d"), (3600.0, "h"), (60.0, "min"))
NAMES = {"SecretStr": "secret", "str": "text", "bool": "true or false", "int": "number", "float": "number"}
SIZES = ((2**40, "TiB"), (2**30, "GiB"), (2**20, "MiB"), (2**10, "KiB"))


def settings_page() -> str:
    """Return the page."""
    parts = [HEAD, cleandoc(module.__doc__ or "") + "\n", _section("The process", "", _own_rows())]
    for name, field in Settings.model_fields.items():
        if is_dataclass(field.default):
            group = type(field.default)
            parts.append(_section(name.capitalize(), getdoc(group) or "", _group_rows(name, field.default)))
    return "\n".join([*parts, REFUSED, table(("variable", "must be", "otherwise"), _bound_rows())])


def _section(title: str, said: str, rows: Iterator[tuple[str, str, str]]) -> str:
    return f"## {title}\n\n{said}\n\n{table(('variable', 'type', 'default'), rows)}"


def _own_rows() -> Iterator[tuple[str, str, str]]:
    for name, field in Settings.model_fields.items():
        if not is_dataclass(field.default):
            yield code(f"STONE_{name.upper()}"), code(_type_name(field.annotation)), _shown(name, field.default)


def _group_rows(group: str, defaults: Any) -> Iterator[tuple[str, str, str]]:
    for item in fields(defaults):
        shown = _shown(item.name, getattr(defaults, item.name))
        yield code(_variable(group, item.name)), code(_type_name(item.type)), shown


def _bound_rows() -> Iterator[tuple[str, str, str]]:
    for bound in BOUNDS:
        needed = f"{'more than' if bound.is_above else 'at least'} {bound.least:g}"
        yield code(bound.variable), needed, bound.otherwise


def _variable(group: str, name: str) -> str:
    return f"STONE_{group.upper()}__{name.upper()}"


def _type_name(kind: Any) -> str:
    """Return the allowed values in words, with bounds of an annotation and choices of a literal."""
    if get_origin(kind) is Annotated:
        inside, *metadata = get_args(kind)
        return ", ".join([_type_name(inside), *(bound for item in metadata for bound in _bounds(item))])
    if get_origin(kind) is Literal:
        return " or ".join(map(str, get_args(kind)))
    name = kind.__name__ if isinstance(kind, type) else str(kind)
    return NAMES.get(name, name)


def _bounds(said: Any) -> list[str]:
    """Return the bounds of a pydantic field."""
    bounds = ((sign, getattr(item, name, None)) for item in getattr(said, "metadata", ()) for name, sign in SIGNS)
    return [f"{sign} {value}" for sign, value in bounds if value is not None]


def _shown(name: str, value: Any) -> str:
    if isinstance(value, SecretStr):
        return "none"
    if isinstance(value, bool):
        return code(str(value).lower())
    if isinstance(value, (int, float)):
        return code(f"{value:.12g}" if isinstance(value, float) else value) + _for_people(name, value)
    return code(value.as_posix() if isinstance(value, Path) else value) or "empty"


def _for_people(name: str, value: float) -> str:
    """Return the value in a readable unit: ` (64 GiB)`, ` (7 d)`."""
    units = SIZES if name.endswith("_bytes") else UNITS if name.endswith("_s") else ()
    for size, unit in units:
        if value >= size:
            return f" ({value / size:g} {unit})"
    return ""
