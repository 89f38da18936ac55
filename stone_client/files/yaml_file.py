"""Small YAML files that people write: no aliases, no foreign tags, bounded size.

**Conventions.** YAML 1.2 by ruamel's safe loader in pure Python; a JSON file is valid YAML too. Values are JSON values;
a date is a text in ISO 8601, in UTC if it has no zone.
"""

from datetime import date, datetime
from math import isfinite
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError
from ruamel.yaml.events import AliasEvent

from stone_base.errors import Refused
from stone_base.newer_python import UTC

MOST_BYTES, MOST = 256 * 1024, 2**63


def read_yaml(path: Path) -> Any:
    """Return the value of a YAML file. Raises `bad_yaml`."""
    try:
        with path.open("rb") as file:
            content = file.read(MOST_BYTES + 1)
        if len(content) > MOST_BYTES:
            raise _bad_yaml(path, f"it is larger than {MOST_BYTES} bytes")
        text = content.decode("utf-8-sig")
        if any(isinstance(event, AliasEvent) for event in YAML(typ="safe", pure=True).parse(text)):
            raise _bad_yaml(path, "aliases (*name) are not allowed")
        return _of_json(YAML(typ="safe", pure=True).load(text))
    except (YAMLError, ValueError, TypeError, RecursionError, AssertionError) as error:
        why = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise _bad_yaml(path, why[:200]) from None


def _of_json(value: Any) -> Any:
    """Return the value with dates as texts. Raises ValueError for a value without a JSON type."""
    if isinstance(value, dict) and all(isinstance(key, str) for key in value):
        return {key: _of_json(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_of_json(item) for item in value]
    if isinstance(value, datetime):
        return (value if value.tzinfo else value.replace(tzinfo=UTC)).isoformat()
    if isinstance(value, date):
        return datetime(value.year, value.month, value.day, tzinfo=UTC).isoformat()
    is_number = (isinstance(value, int) and abs(value) < MOST) or (isinstance(value, float) and isfinite(value))
    if not (value is None or isinstance(value, str) or is_number):
        raise ValueError(f"a value ({type(value).__name__}) has no JSON type (text, number, true, false, null)")
    return value


def _bad_yaml(path: Path, why: str) -> Refused:
    return Refused("bad_yaml", f"{path} cannot be read as YAML: {why}")
