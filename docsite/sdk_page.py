"""The reference of the SDK, from the docstrings and signatures of its classes."""

import inspect
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from types import FunctionType
from typing import Any

from docsite.markdown import code, plain
from stone_client import sdk

HEAD = """# Python SDK: reference

`from stone_client import Stone`; the other classes are in `stone_client.sdk`. A program starts with a
[Stone](#stone), whose methods return the other objects. The [guide](../sdk.md) shows their use.
"""


def sdk_page() -> str:
    """Return the page: `Stone` first, then the classes by name."""
    names = [name for name in sdk.__all__ if inspect.isclass(getattr(sdk, name))]
    return "\n".join([HEAD, *map(_section, sorted(names, key=lambda name: (name != "Stone", name)))])


def _section(name: str) -> str:
    kind = getattr(sdk, name)
    parts = [f"## {name}\n", f"{_text(kind)}\n"]
    if is_dataclass(kind):
        listed = ", ".join(code(f"{item.name}: {item.type}") for item in fields(kind) if not item.name.startswith("_"))
        parts.append(f"Fields: {listed}\n")
    else:
        parts.append(f"```\n{name}{_signature(kind.__init__)}\n```\n")
    return "\n".join([*parts, *_members(kind)])


class _Words(str):
    """Text that a signature shows without quotes."""

    __repr__ = str.__str__


def _members(kind: type) -> Iterator[str]:
    for name, member in vars(kind).items():
        is_shown = member.__doc__ and (not name.startswith("_") or name == "__getitem__")
        if is_shown and isinstance(member, property):
            yield f"### {kind.__name__}.{name}\n\n{_text(member)}\n"
        elif is_shown and isinstance(member, FunctionType):
            yield f"### {kind.__name__}.{name}\n\n```\n{name}{_signature(member)}\n```\n\n{_text(member)}\n"


def _signature(function: Callable[..., Any]) -> str:
    """Return the signature as in the source, without `self`."""
    signature = inspect.signature(function)
    shown = [_in_words(item) for item in signature.parameters.values() if item.name != "self"]
    returned = signature.return_annotation
    return str(signature.replace(parameters=shown, return_annotation=_Words(returned)))


def _in_words(parameter: inspect.Parameter) -> inspect.Parameter:
    default = parameter.default
    named = _Words(default.__name__) if isinstance(default, FunctionType) else default
    return parameter.replace(annotation=_Words(parameter.annotation), default=named)


def _text(documented: Any) -> str:
    """Return the docstring; indented parts are code."""
    blocks = (inspect.getdoc(documented) or "").split("\n\n")
    return "\n\n".join(block if block.startswith("    ") else plain(block) for block in blocks)
