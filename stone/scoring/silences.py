"""Why no interval is told of a score, or of a difference of scores.

**Conventions.** A silence is a code; its sentence goes on after "Nothing is said of it:". This module loads nothing, so
that every process may.
"""

from collections.abc import Mapping
from typing import Literal, get_args

Scope = Literal["these_places", "new_place"]
Silence = Literal[
    "undefined",
    "no_wander",
    "few_frames",
    "concentrated",
    "few_sequences",
    "uneven_sequences",
    "unknown_order",
    "withdrawn",
]

SCOPES: tuple[Scope, ...] = get_args(Scope)
FEWEST_SEQUENCES = 5
UNKNOWN_ORDER: Silence = "unknown_order"
WITHDRAWN: Silence = "withdrawn"
SILENCES: Mapping[Silence, str] = {
    "undefined": "it is undefined",
    "no_wander": "it does not vary between frames, so its uncertainty cannot be estimated",
    "few_frames": "too few independent frames (neighbouring frames are correlated)",
    "concentrated": "most of the voxels counted lie in a few frames",
    "few_sequences": f"at least {FEWEST_SEQUENCES} sequences are needed",
    "uneven_sequences": "a few sequences hold most of the voxels counted",
    "unknown_order": "the order of the frames in time is not known, and with it how alike neighbouring frames are",
    "withdrawn": "the intervals of this metric version were too narrow and have been withdrawn",
}
