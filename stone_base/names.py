"""Names that everybody writes alike: of sequences, and of the parts of a split."""

import re
from typing import Literal

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")
"""A sequence's name in full; it becomes a folder's name."""

Part = Literal["train", "val", "test"]
PARTS: tuple[Part, ...] = ("train", "val", "test")
