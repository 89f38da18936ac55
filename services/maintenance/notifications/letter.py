"""A delivery in the words that its reader gets, whatever the channel."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Letter:
    """`message_id` is equal in every try of one delivery, `event_id` in every delivery of one event; `url` is the page
    that says more, `settings_url` that on which one chooses otherwise."""

    message_id: str
    event_id: str
    kind: str
    happened_at: str
    text: str
    url: str
    settings_url: str
    data: Mapping[str, Any] = field(default_factory=dict)
