"""Findings about a field of a request, from a pydantic error.

**Conventions.** `expected` is what the field accepts, `actual` the kind and size of the sent value, `detail` a sentence
with both. Text from the request is never repeated, because it may be a secret; numbers of numeric fields are repeated.
"""

import re
from collections.abc import Mapping
from typing import Any

from api.schemas.base import ID_PATTERN, PLAIN, PROSE

MOST_WORDS = 200
MOST_NAME = 64
MOST_DEPTH = 8
OWN = "Value error, "
"""The prefix of pydantic's sentence for a `ValueError` raised by a validator."""
PATTERNS = {
    ID_PATTERN: "an id of 32 hexadecimal digits",
    PLAIN: "one line of text without control or invisible characters",
    PROSE: "text without control or invisible characters",
}
TEXT, WHOLE, NUMBER, BOOLEAN, LIST, OBJECT = (
    "text",
    "a whole number",
    "a number",
    "true or false",
    "a list",
    "an object",
)
MOMENT = "a date and time such as 2026-05-03T09:12:44Z"
EXPECTED = {
    "missing": "a value",
    "extra_forbidden": "a known key",
    "json_invalid": "JSON",
    **dict.fromkeys(("string_type", "string_unicode", "string_sub_type"), TEXT),
    **dict.fromkeys(("int_type", "int_parsing", "int_from_float", "int_parsing_size"), WHOLE),
    **dict.fromkeys(("float_type", "float_parsing"), NUMBER),
    "finite_number": "a finite number",
    **dict.fromkeys(("bool_type", "bool_parsing"), BOOLEAN),
    **dict.fromkeys(("list_type", "tuple_type", "set_type"), LIST),
    **dict.fromkeys(("dict_type", "model_type", "model_attributes_type", "dataclass_type"), OBJECT),
    **dict.fromkeys(
        ("datetime_type", "datetime_parsing", "datetime_from_date_parsing", "datetime_object_invalid"), MOMENT
    ),
    "timezone_aware": "a date and time with an offset from UTC, such as 2026-05-03T09:12:44Z",
    "string_too_short": "at least {min_length} character(s)",
    "string_too_long": "at most {max_length} character(s)",
    "too_short": "at least {min_length} item(s)",
    "too_long": "at most {max_length} item(s)",
    "greater_than": "more than {gt}",
    "greater_than_equal": "at least {ge}",
    "less_than": "less than {lt}",
    "less_than_equal": "at most {le}",
    "multiple_of": "a multiple of {multiple_of}",
    "literal_error": "one of {expected}",
    "enum": "one of {expected}",
    "none_required": "null",
}
NUMERIC = {"greater_than", "greater_than_equal", "less_than", "less_than_equal", "multiple_of", "finite_number"}
DIGITS = re.compile(r"[+-]?\d{1,20}(\.\d{1,20})?")


def field_finding(raw: Mapping[str, Any]) -> dict[str, str]:
    """Return the finding of one error of `RequestValidationError.errors()`."""
    code, where = str(raw["type"])[:64], ".".join(str(part)[:MOST_NAME] for part in raw["loc"][:MOST_DEPTH])
    expected = _expected(code, raw)
    if not expected:  # from one of our validators, or a rule missing in the table
        return {"code": code, "where": where, "detail": str(raw["msg"]).removeprefix(OWN)[:MOST_WORDS]}
    if code == "extra_forbidden":
        detail = "unknown key; the API reference lists the keys of this body"
        return {"code": code, "where": where, "expected": expected, "detail": detail}
    actual = _actual(code, raw)
    return {
        "code": code,
        "where": where,
        "expected": expected,
        "actual": actual,
        "detail": f"expected {expected}; found {actual}",
    }


def _expected(code: str, raw: Mapping[str, Any]) -> str:
    context = {
        name: f"{value:.12g}" if isinstance(value, float) else value for name, value in raw.get("ctx", {}).items()
    }
    if code == "string_pattern_mismatch":
        return PATTERNS.get(context["pattern"], f"text that matches {context['pattern']}")[:MOST_WORDS]
    return EXPECTED.get(code, "").format(**context)[:MOST_WORDS]


def _actual(code: str, raw: Mapping[str, Any]) -> str:
    if code == "missing":
        return "nothing"
    if code == "json_invalid":
        return f"invalid JSON at character {raw['loc'][-1]}"
    sent = raw["input"]
    if code in NUMERIC and DIGITS.fullmatch(str(sent)):
        return str(sent)
    return described(sent)


def described(sent: object) -> str:
    """Return the kind and size of a value, never the value."""
    match sent:
        case None:
            return "null"
        case bool():
            return BOOLEAN
        case int() | float():
            return NUMBER
        case str():
            return f"text of {len(sent)} character(s)"
        case list() | tuple():
            return f"a list of {len(sent)} item(s)"
        case dict():
            return f"an object of {len(sent)} key(s)"
    return "another kind of value"
