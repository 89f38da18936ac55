"""Small YAML files that people write: no aliases, no tags of other programs, bounded size.

**Conventions.** YAML 1.2 by ruamel's safe loader in pure Python; a JSON file is one too.
"""

from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError
from ruamel.yaml.events import AliasEvent

from stone_base.errors import Refused

MOST_BYTES = 256 * 1024


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
        return YAML(typ="safe", pure=True).load(text)
    except (YAMLError, ValueError, TypeError, RecursionError, AssertionError) as error:
        why = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise _bad_yaml(path, why[:200]) from None


def _bad_yaml(path: Path, why: str) -> Refused:
    return Refused("bad_yaml", f"{path} cannot be read as YAML: {why}")
