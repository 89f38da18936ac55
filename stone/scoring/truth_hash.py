"""Hashes of ground truths, which identify the labels of a score."""

from collections.abc import Mapping
from hashlib import sha256

from stone.scoring.frame_counts import TruthPlanes


def truth_hash(truth: TruthPlanes) -> bytes:
    """Return the hash of all data of one frame that scores depend on: the evaluated voxels and their labels."""
    return sha256(truth.planes.data).digest()


def whole_hash(hashes: Mapping[str, bytes]) -> str:
    """Return the hash of a whole ground truth, from `truth_hash` by token, independent of the frame order."""
    return sha256(b"".join(token.encode() + hashes[token] for token in sorted(hashes))).hexdigest()
