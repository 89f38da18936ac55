"""The manifest: the exact set of frames that a submission must contain.

**Conventions.** JSON: `{"stone_manifest": 1, "sequences": {"<sequence name>": ["<frame_token>", …]}}`, plus `grid`
(`stone_base.label_grid`) if it is not the paper's. Sequence names follow `stone/sensors/sequence.py`; a frame token is
32 lower-case hex digits and occurs once. The order of tokens has no meaning. A manifest reveals no labels.
"""

import json
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from stone_base.errors import Refused, StoneError
from stone_base.label_grid import PAPER, LabelGrid, grid_of
from stone_base.names import NAME
from stone_files.atomic import atomic_file
from stone_submissions.errors import UnreadableInputError, bad_manifest

VERSION = 1
TOKEN = re.compile(r"[0-9a-f]{32}")
SEQUENCE_NAME = NAME
MAX_MANIFEST_BYTES = 8 * 2**20
MAX_FRAMES = 200_000


@dataclass(frozen=True)
class Manifest:
    """Frame tokens by sequence name, and the grid of all frames."""

    sequences: Mapping[str, tuple[str, ...]]
    grid: LabelGrid = PAPER

    @property
    def tokens(self) -> tuple[str, ...]:
        return tuple(token for tokens in self.sequences.values() for token in tokens)

    def as_record(self) -> dict[str, object]:
        sequences = {name: list(tokens) for name, tokens in self.sequences.items()}
        grid = {} if self.grid == PAPER else {"grid": self.grid.as_record()}
        return {"stone_manifest": VERSION, **grid, "sequences": sequences}


def read_manifest(path: Path) -> Manifest:
    """Return the manifest in this file.

    Raises `UnreadableInputError` if it cannot be opened and `bad_manifest` if it does not have the format above.
    """
    raw = read_bounded(path, MAX_MANIFEST_BYTES, bad_manifest)
    try:
        record = json.loads(raw)
    except (ValueError, RecursionError) as error:
        raise bad_manifest(path, "not JSON") from error
    fault = next(_faults(record), None)
    if fault is not None:
        raise bad_manifest(path, fault)
    return Manifest({name: tuple(tokens) for name, tokens in record["sequences"].items()}, _grid_in(path, record))


def _grid_in(path: Path, record: Mapping[str, object]) -> LabelGrid:
    """Return the grid of a manifest. Raises `bad_manifest`."""
    if "grid" not in record:
        return PAPER
    try:
        return grid_of(record["grid"])
    except Refused as error:
        raise bad_manifest(path, str(error)) from error


def write_manifest(path: Path, manifest: Manifest) -> None:
    """Write the file atomically."""
    with atomic_file(path) as staging:
        staging.write_text(json.dumps(manifest.as_record(), indent=1) + "\n", encoding="utf-8")


def _faults(record: object) -> Iterator[str]:
    if not isinstance(record, dict) or record.get("stone_manifest") != VERSION:
        yield f"expected an object with stone_manifest {VERSION}"
        return
    sequences = record.get("sequences")
    if not isinstance(sequences, dict) or not all(isinstance(tokens, list) for tokens in sequences.values()):
        yield "expected sequences: an object with a list of frame tokens for each name"
        return
    yield from (f"sequence name {name[:40]!r}" for name in sequences if not SEQUENCE_NAME.fullmatch(name))
    tokens = [token for listed in sequences.values() for token in listed]
    yield from (f"frame token {str(token)[:40]!r}" for token in tokens if not is_token(token))
    if not 0 < len(tokens) <= MAX_FRAMES:
        yield f"it has {len(tokens)} frames; 1 to {MAX_FRAMES} are allowed"
    if len(set(map(str, tokens))) < len(tokens):
        yield "a frame token occurs twice"


def is_token(text: object) -> bool:
    """Return whether this is a frame token: 32 lower-case hex digits."""
    return isinstance(text, str) and TOKEN.fullmatch(text) is not None


def read_bounded(path: Path, limit_bytes: int, refusal: Callable[[Path, str], StoneError]) -> bytes:
    """Return the bytes of a small file, reading at most `limit_bytes`.

    Raises `UnreadableInputError` if it cannot be opened, and `refusal(path, fault)` if it is larger.
    """
    try:
        with path.open("rb") as file:
            content = file.read(limit_bytes + 1)
    except OSError as error:
        raise UnreadableInputError(path, error.strerror or "unknown reason") from error
    if len(content) > limit_bytes:
        raise refusal(path, f"larger than {limit_bytes} bytes")
    return content
