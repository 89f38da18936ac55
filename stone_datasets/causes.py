"""The likely mistake behind an invalid value, and its fix.

**Conventions.** Every function returns "" if the value shows no mistake; then the hint of the code is used.
"""

import re
from collections.abc import Iterable

from stone_datasets.stamps import MICROSECONDS, SECONDS, unit_of

HEX = re.compile(r"[0-9a-f]+")
NEW_TOKEN = "uuid.uuid4().hex creates a token, hashlib.md5(name.encode()).hexdigest() creates one from any name"


def type_cause(key: str, value: object) -> str:
    """Return why a key's value has the wrong type."""
    if value is None:
        return "null: the value was never filled in"
    if key == "timestamp" and isinstance(value, float):
        unit = unit_of(value) or SECONDS
        return f"{unit.name} as a float: {unit.mended}" + ("" if unit is MICROSECONDS else " and round")
    if isinstance(value, str):
        return "the number is written as text" if _is_number(value) else "the value is text"
    if isinstance(value, dict):
        return "an object; the schema requires a list of numbers" if key in ("rotation", "translation") else "an object"
    if isinstance(value, list):
        return _list_cause(value)
    if "token" in key or key in ("prev", "next"):
        return f"a number; tokens are text of 32 hex digits: {NEW_TOKEN}"
    if isinstance(value, bool):
        return "a boolean where a number is expected"
    if key == "is_key_frame":
        return "a number; JSON has true and false"
    return "a float; write int(value)" if isinstance(value, float) else ""


def token_cause(text: str) -> str:
    """Return why this text is not a frame token."""
    plain = text.replace("-", "")
    if len(plain) == 32 and HEX.fullmatch(plain.lower()):
        if plain != plain.lower():
            return "upper-case letters; write token.lower() in all tables and in the names of label folders"
        return "dashes at other positions than in a UUID; write token.replace('-', '') everywhere"
    if HEX.fullmatch(text.lower()) and 28 <= len(text) <= 40:
        return f"{len(text)} hex digits instead of 32"
    return (
        f"a name, counter or stamp instead of 32 hex digits; {NEW_TOKEN}; use the same token in every table and "
        "label folder"
    )


def folder_cause(name: str, folders: Iterable[str]) -> str:
    """Return why a file's name does not start with one of the folders, such as `samples/LIDAR_TOP/`."""
    for folder in folders:
        before, separator, _ = name.partition(f"/{folder}")
        if separator:
            return f"paths must start with samples/ or sweeps/, relative to the dataset: remove {before[:80]!r}"
        if name.lower().startswith(folder.lower()) and not name.startswith(folder):
            return "its folder and the sensor differ in upper and lower case"
    return "" if "/" in name else "a file name without its folder samples/<CHANNEL>/"


def _list_cause(value: list[object]) -> str:
    if any(isinstance(item, str) for item in value):
        return "numbers written as text" if all(_is_number(item) for item in value) else "text in a list of numbers"
    if any(item is None for item in value):
        return "null in a list of numbers"
    if len(value) == 1 and isinstance(value[0], list):
        return "a list within a list: remove the outer brackets"
    return f"a list of {len(value)}"


def _is_number(value: object) -> bool:
    try:
        float(str(value))
    except ValueError:
        return False
    return True
