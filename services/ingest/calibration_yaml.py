"""A small plain YAML document from a hostile file: no aliases, no tags, no depth, no size, and one sentence on refusal.

**Conventions.** YAML 1.2 by ruamel's safe loader in pure Python. The events are counted before anything is built from
them, so that a bomb costs what its bytes cost.
"""

from pathlib import Path

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.events import AliasEvent, CollectionEndEvent, CollectionStartEvent, NodeEvent

from services.ingest.calibration_errors import CalibrationSizeError, CalibrationYamlError

SIZE_LIMIT_BYTES = 1_000_000
DEPTH_LIMIT = 12
NODE_LIMIT = 10_000
SHOWN_CHARACTERS = 120


def read_yaml(path: Path) -> object:
    """The one document of the file. Raises CalibrationSizeError, CalibrationYamlError, OSError."""
    with path.open("rb") as file:
        content = file.read(SIZE_LIMIT_BYTES + 1)
    if len(content) > SIZE_LIMIT_BYTES:
        raise CalibrationSizeError(path.name, SIZE_LIMIT_BYTES)
    return parse_yaml(path.name, content)


def parse_yaml(name: str, content: bytes) -> object:
    """The document in `content`. Raises CalibrationYamlError."""
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise CalibrationYamlError(name, f"byte {error.start} is not UTF-8 text (a binary file?)") from None
    try:
        _check_events(name, text)
        return YAML(typ="safe", pure=True).load(text)
    except YAMLError as error:
        raise CalibrationYamlError(name, _sentence(error)) from None
    except (ValueError, OverflowError) as error:
        raise CalibrationYamlError(name, str(error)[:SHOWN_CHARACTERS]) from None


def _check_events(name: str, text: str) -> None:
    depth = nodes = 0
    for event in YAML(typ="safe", pure=True).parse(text):
        if isinstance(event, AliasEvent) or getattr(event, "anchor", None):
            raise CalibrationYamlError(name, f"anchors and aliases (line {event.start_mark.line + 1}) are not allowed")
        if getattr(event, "tag", None):
            raise CalibrationYamlError(name, f"the tag on line {event.start_mark.line + 1} is not allowed")
        depth += isinstance(event, CollectionStartEvent) - isinstance(event, CollectionEndEvent)
        nodes += isinstance(event, NodeEvent)
        if depth > DEPTH_LIMIT:
            raise CalibrationYamlError(name, f"it is nested deeper than {DEPTH_LIMIT} levels")
        if nodes > NODE_LIMIT:
            raise CalibrationYamlError(name, f"it has more than {NODE_LIMIT} values")


def _sentence(error: YAMLError) -> str:
    if isinstance(error, MarkedYAMLError) and error.problem_mark is not None:
        problem = " ".join(str(error.problem or error.context or "malformed").split())[:SHOWN_CHARACTERS]
        return f"{problem} on line {error.problem_mark.line + 1}"
    return " ".join(str(error).split())[:SHOWN_CHARACTERS]
