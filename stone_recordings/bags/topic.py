"""A topic of a recording: its name, its type and how its payloads are written.

**Conventions.** `type` is written `package/msg/Name`; `schema` is the ros2msg text embedded in the recording, "" where
none is; `encoding` is how payloads are written.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Topic:
    name: str
    type: str
    count: int
    schema: str
    encoding: str = "cdr"
