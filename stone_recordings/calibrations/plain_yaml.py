"""Small plain YAML or JSON from a hostile file: no aliases, no tags, bounded depth and size, one sentence per refusal.

**Conventions.** YAML 1.2 by ruamel's safe loader in pure Python; the events are counted before anything is built from
them, so that a bomb costs no more than its bytes. A text that starts with a brace or a bracket is tried as JSON first;
its depth is counted before parsing. OpenCV's `%YAML:1.0` (invalid YAML) is read as `%YAML 1.0`, and its tag
`!!opencv-matrix` is the only accepted tag, on a mapping. KITTI's tracking files lack three colons, which are inserted.
Several documents in one file are the output of `ros2 topic echo /tf_static`; elsewhere they are refused.
"""

import json
import re
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.constructor import SafeConstructor
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.events import (
    AliasEvent,
    CollectionEndEvent,
    CollectionStartEvent,
    DocumentStartEvent,
    MappingStartEvent,
    NodeEvent,
)

from stone_recordings.calibrations.errors import CalibrationYamlError

DEPTH_LIMIT = 12
NODE_LIMIT = 10_000
SHOWN_CHARACTERS = 120
OPENCV_HEAD = re.compile(r"\A%YAML[: ]1\.0[^\n]*")
OPENCV_TAG = "tag:yaml.org,2002:opencv-matrix"
KITTI_WITHOUT_COLON = re.compile(r"(?m)^(R_rect|Tr_velo_cam|Tr_imu_velo)(?= +[-+.\d])")
JSON_STRING = re.compile(r'"(?:[^"\\]|\\.)*"')


class OpenCvMatrix(dict[str, object]):
    """A mapping tagged as a matrix of OpenCV: rows, cols, dt and data."""


class _MatrixConstructor(SafeConstructor):
    """Builds OpenCV matrices, beside safe values."""

    def matrix(self, node: Any) -> OpenCvMatrix:
        return OpenCvMatrix(self.construct_mapping(node, deep=True))


_MatrixConstructor.add_constructor(OPENCV_TAG, _MatrixConstructor.matrix)


def parse_documents(name: str, content: bytes) -> tuple[object, ...]:
    """Return the documents in `content`, at least one; trailing empty ones are dropped. Raises CalibrationYamlError."""
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise CalibrationYamlError(name, f"byte {error.start} is not UTF-8 text (a binary file?)") from None
    if text.lstrip()[:1] in ("{", "[") and (value := _json(name, text)) is not None:
        return (value,)
    return _yaml(name, KITTI_WITHOUT_COLON.sub(r"\1:", OPENCV_HEAD.sub("", text)))


def _json(name: str, text: str) -> object | None:
    """Return the value, or None if the text is no JSON (it may be YAML in flow style)."""
    depth = deepest = 0
    skeleton = re.sub(r"[^][{},]", "", JSON_STRING.sub("", text))
    for sign in skeleton:
        depth += (sign in "[{") - (sign in "]}")
        deepest = max(deepest, depth)
    if deepest > DEPTH_LIMIT:
        raise CalibrationYamlError(name, f"it is nested deeper than {DEPTH_LIMIT} levels")
    if len(skeleton) > 3 * NODE_LIMIT:
        raise CalibrationYamlError(name, f"it has more than {NODE_LIMIT} values")
    try:
        value: object = json.loads(text, object_pairs_hook=_entries)
        return value
    except _RepeatedKeyError as error:
        raise CalibrationYamlError(name, str(error)) from None
    except ValueError:
        return None


class _RepeatedKeyError(Exception):
    """Not a ValueError: JSON that repeats a key is refused, not tried as YAML."""


def _entries(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    entries = dict(pairs)
    if len(entries) < len(pairs):
        keys = [key for key, _ in pairs]
        repeated = next(key for key in keys if keys.count(key) > 1)
        raise _RepeatedKeyError(f"the key {repeated[:40]!r} is given twice")
    return entries


def _yaml(name: str, text: str) -> tuple[object, ...]:
    try:
        second_line = _check_events(name, text)
        loader = YAML(typ="safe", pure=True)
        loader.Constructor = _MatrixConstructor
        documents = list(loader.load_all(text))
    except YAMLError as error:
        raise CalibrationYamlError(name, _sentence(error)) from None
    except TypeError:  # the loader's error for an invalid key
        problem = "a key is itself a list or a mapping (a comma or a quote too many?)"
        raise CalibrationYamlError(name, problem) from None
    except (ValueError, OverflowError, AssertionError) as error:  # ruamel asserts the numbers of a %YAML line
        raise CalibrationYamlError(name, str(error)[:SHOWN_CHARACTERS]) from None
    while len(documents) > 1 and documents[-1] is None:
        documents.pop()
    if len(documents) > 1 and not all(
        isinstance(document, dict) and "transforms" in document for document in documents
    ):
        raise CalibrationYamlError(name, f"found another document on line {second_line}")
    return tuple(documents or [None])


def _check_events(name: str, text: str) -> int:
    """Return the line on which the second document starts, 0 for a single document."""
    depth = nodes = 0
    lines: list[int] = []
    for event in YAML(typ="safe", pure=True).parse(text):
        if isinstance(event, AliasEvent) or getattr(event, "anchor", None):
            raise CalibrationYamlError(name, f"anchors and aliases (line {event.start_mark.line + 1}) are not allowed")
        if getattr(event, "tag", None) and not (event.tag == OPENCV_TAG and isinstance(event, MappingStartEvent)):
            raise CalibrationYamlError(name, f"the tag on line {event.start_mark.line + 1} is not allowed")
        if isinstance(event, DocumentStartEvent):
            lines.append(event.start_mark.line + 1)
        depth += isinstance(event, CollectionStartEvent) - isinstance(event, CollectionEndEvent)
        nodes += isinstance(event, NodeEvent)
        if depth > DEPTH_LIMIT:
            raise CalibrationYamlError(name, f"it is nested deeper than {DEPTH_LIMIT} levels")
        if nodes > NODE_LIMIT:
            raise CalibrationYamlError(name, f"it has more than {NODE_LIMIT} values")
    return lines[1] if len(lines) > 1 else 0


def _sentence(error: YAMLError) -> str:
    if isinstance(error, MarkedYAMLError) and error.problem_mark is not None:
        problem = " ".join(str(error.problem or error.context or "malformed").split())[:SHOWN_CHARACTERS]
        return f"{problem} on line {error.problem_mark.line + 1}"
    return " ".join(str(error).split())[:SHOWN_CHARACTERS]
