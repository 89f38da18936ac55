"""Why no interval is told of a score, or of a difference of scores.

**Conventions.** A silence is a code; its sentence goes on after "Nothing is said of it:". This module loads nothing, so
that every process may.
"""

from collections.abc import Mapping
from typing import Literal, get_args

Scope = Literal["these_places", "new_place"]
Silence = Literal[
    "undefined", "no_wander", "few_frames", "concentrated", "few_sequences", "uneven_sequences", "withdrawn"
]

SCOPES: tuple[Scope, ...] = get_args(Scope)
FEWEST_SEQUENCES = 5
WITHDRAWN: Silence = "withdrawn"
SILENCES: Mapping[Silence, str] = {
    "undefined": "it is undefined",
    "no_wander": "it is the same throughout, which tells nothing of its uncertainty",
    "few_frames": "there are too few frames for how alike neighbouring ones are",
    "concentrated": "most of what it counts lies in a few of the frames",
    "few_sequences": f"it takes {FEWEST_SEQUENCES} sequences or more",
    "uneven_sequences": "a few of the sequences hold most of what it counts",
    "withdrawn": "the intervals of this metric version claimed more than was known, and are withdrawn",
}
