"""JSON schemas as Markdown tables: a row per key.

**Conventions.** Only the constructs of our documents are supported: references, unions, lists, maps, constants and
enums with their bounds. Other constructs are shown as their type.
"""

import json
from collections.abc import Iterator, Mapping
from typing import Any

from docsite.markdown import code, plain, table

BODIES = "bodies.md"
BOUNDS = (
    ("minimum", "≥"),
    ("exclusiveMinimum", ">"),
    ("maximum", "≤"),
    ("exclusiveMaximum", "<"),
    ("minLength", "length ≥"),
    ("maxLength", "length ≤"),
    ("minItems", "items ≥"),
    ("maxItems", "items ≤"),
)
Schema = Mapping[str, Any]


def body_link(reference: str) -> str:
    """Return the name of a body as a link to its section."""
    name = reference.rpartition("/")[2]
    return f"[{code(name)}]({BODIES}#{anchor_of(name)})"


def anchor_of(name: str) -> str:
    """Return the anchor of a body's section."""
    return "body-" + "".join(letter if letter.isalnum() else "-" for letter in name).lower()


def body_section(name: str, schema: Schema) -> str:
    """Return the section of a body: its description, keys and example."""
    rows = list(_rows(schema)) or ([("", type_of(schema), "")] if "properties" not in schema else [])
    examples = schema.get("examples")
    shown = f"```json\n{json.dumps(examples[0], indent=1, ensure_ascii=False)}\n```\n" if examples else ""
    description = plain(schema.get("description", ""))
    return f"## {plain(name)} {{#{anchor_of(name)}}}\n\n{description}\n\n{table(('key', 'type', ''), rows)}\n{shown}"


def _rows(schema: Schema) -> Iterator[tuple[str, str, str]]:
    needed = set(schema.get("required", ()))
    for key, value in schema.get("properties", {}).items():
        need = "" if key in needed else " (optional)"
        yield code(key) + need, type_of(value), plain(value.get("description", ""))


def type_of(schema: Schema) -> str:
    """Return the type in words, with its bounds."""
    if "$ref" in schema:
        return body_link(schema["$ref"])
    for union in ("anyOf", "oneOf", "allOf"):
        if union in schema:
            return " or ".join(dict.fromkeys(type_of(option) for option in schema[union]))
    if "const" in schema:
        return code(json.dumps(schema["const"]))
    if "enum" in schema:
        return " or ".join(code(json.dumps(option)) for option in schema["enum"])
    return _plain_type(schema) + _bounds(schema)


def _plain_type(schema: Schema) -> str:
    kind = schema.get("type", "anything")
    if kind == "array":
        inside = [*schema.get("prefixItems", ())] or [schema.get("items", {})]
        return "list of " + ", ".join(dict.fromkeys(type_of(item) for item in inside))
    if kind == "object":
        return f"object of {type_of(schema['additionalProperties'])}" if _is_map(schema) else "object"
    form = schema.get("format", "")
    return {"string": "text", "integer": "whole number", "boolean": "true or false"}.get(kind, str(kind)) + (
        f" ({form})" if form else ""
    )


def _is_map(schema: Schema) -> bool:
    return isinstance(schema.get("additionalProperties"), Mapping)


def _bounds(schema: Schema) -> str:
    bounds = [f"{words} {schema[key]:.12g}" for key, words in BOUNDS if key in schema]
    return f", {', '.join(bounds)}" if bounds else ""
