"""The word of every state that a page shows: one key, one word, everywhere.

**Conventions.** Keys are the values of the API and the database, which never change for a word's sake; `data-state` of
an element is the key, its text the word. A key that is missing here is shown as it is written.
"""

from collections.abc import Mapping

STATE_WORDS: Mapping[str, str] = {
    # jobs, runs, attempts, exports, comparisons, imports
    "queued": "queued",
    "running": "running",
    "succeeded": "succeeded",
    "failed": "failed",
    "cancelled": "cancelled",
    "lost": "lost",
    "waiting": "waiting",
    # sequences and their recordings
    "empty": "no recording",
    "reading": "reading",
    "recorded": "not labelled",
    "processing": "processing",
    "labelled": "labelled",
    "received": "reading",
    "registered": "registered",
    "refused": "refused",
    # submissions
    "draft": "draft",
    "scoring": "scoring",
    "scored": "scored",
    "valid": "valid",
    "invalid": "invalid",
    "withdrawn": "withdrawn",
    "hidden": "hidden",
    # ground truths, inputs, playbacks, re-scores
    "none": "none",
    "making": "being made",
    "ready": "ready",
    "missing": "missing",
    "active": "active",
    "incomplete": "incomplete",
    "complete": "complete",
    "activated": "activated",
    "abandoned": "abandoned",
    # phases
    "upcoming": "upcoming",
    "open": "open",
    "closed": "closed",
    # queues and workers
    "paused": "paused",
    "draining": "draining",
    "busy": "busy",
    "idle": "idle",
    "silent": "silent",
    # deliveries of notifications
    "delivered": "delivered",
    "dropped": "dropped",
    "dead": "given up",
    # users, webhooks, addresses, tokens
    "deactivated": "deactivated",
    "disabled": "disabled",
    "failing": "failing",
    "verified": "verified",
    "unverified": "not verified",
    "expired": "expired",
}


def state_word(state: str) -> str:
    """The word of the state."""
    return STATE_WORDS.get(state, state.replace("_", " "))
