"""Ids and times of the listed rows, made of numbers, so that every answer is the same bytes.

**Conventions.** `id_of(kind, number)` is an id that sorts by kind, then by number. Times are `EPOCH_NS` plus
microseconds of their own, so that a time without a fraction and one with are both there.
"""

EPOCH_NS = 1_777_799_564_000_000_000
FAR_NS = 4_000_000_000 * 10**9
SHA = "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"
STATES = ("succeeded", "failed", "cancelled", "queued", "succeeded")
KINDS = (
    "user", "team", "sequence", "job", "labels", "artefact", "recording", "export", "submission", "dataset", "token",
)  # fmt: skip


def id_of(kind: str, number: int) -> str:
    return f"{KINDS.index(kind) + 1:04x}{number:028x}"


def at_ns(number: int) -> int:
    """An instant; of every third the microseconds are none."""
    return EPOCH_NS + number * 10**9 + (0 if number % 3 == 0 else number * 1000)
