"""The order of ground truth frames in time, from the tables that the labeler writes beside them.

**Conventions.** A table is a `frames.parquet` (`services/labeler/tables.py`): beside `gts`, or in the folder of a
sequence below it, where several label sets lie together. Frame tokens are hashes: their own order says nothing.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

from stone_submissions.errors import GroundTruthError

TABLE = "frames.parquet"
COLUMNS = ("frame_token", "stamp_ns")


def in_time_order(root: Path, sequences: Mapping[str, Sequence[str]]) -> dict[str, tuple[str, ...]] | None:
    """The tokens of each sequence by their stamps; None where a frame is in none of the tables.

    `root` is the folder of the sequences. Raises `GroundTruthError` for a table that cannot be read.
    """
    beside = _stamps_ns((root.parent if root.name == "gts" else root) / TABLE)
    ordered = dict[str, tuple[str, ...]]()
    for name, tokens in sequences.items():
        stamps_ns = beside | _stamps_ns(root / name / TABLE)
        if not all(token in stamps_ns for token in tokens):
            return None
        ordered[name] = tuple(sorted(tokens, key=lambda token: (stamps_ns[token], token)))
    return ordered


def _stamps_ns(path: Path) -> dict[str, int]:
    """Stamp by frame token, of the frames that have labels; of no file, none."""
    if not path.is_file():
        return {}
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        rows = pq.read_table(path, columns=list(COLUMNS)).to_pydict()
        pairs = zip(*(rows[name] for name in COLUMNS), strict=True)
        return {str(token): int(stamp_ns) for token, stamp_ns in pairs if token is not None}
    except (OSError, KeyError, TypeError, ValueError, pa.ArrowException) as error:
        raise GroundTruthError(path, f"no table of frames: {error}") from error
