"""Which recordings are on one clock, by the messages and the topics that they share.

**Conventions.** Messages that both hold tell exactly: by their stamps where those differ by a constant (somebody moved
one file), else by when each recorder logged them, whose scatter is that of the transport. Topics of sensors that one
recording goes on with where the other ends are of a run that the recorder cut: one clock.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from stone.sensors.shared_messages import SharedMessages, TopicMessages, shared_messages
from stone_files.joined_file import SAME_MESSAGES, SAME_TOPICS
from stone_recordings.joining.held_messages import HeldMessages

# Two recorders of one host log a message so far apart; what is less is no offset of a clock.
TRANSPORT_NS = 1_000_000


@dataclass(frozen=True)
class ClockOffset:
    """What is added to a recording's times to be on another's clock. `sigma_ns` and the rest as of `JoinedMember`."""

    offset_ns: int
    sigma_ns: int | None
    known_by: tuple[str, ...]
    kept_topics: tuple[str, ...] = ()

    def reversed(self) -> "ClockOffset":
        return ClockOffset(-self.offset_ns, self.sigma_ns, self.known_by, self.kept_topics)

    def after(self, other: "ClockOffset") -> "ClockOffset":
        """This one, of a recording whose own offset is known against one that is `other` off."""
        sigmas = (self.sigma_ns or 0, other.sigma_ns or 0)
        known_by = tuple(dict.fromkeys((*other.known_by, *self.known_by)))
        kept = self.kept_topics if not other.offset_ns else ()
        return ClockOffset(self.offset_ns + other.offset_ns, round(sum(s**2 for s in sigmas) ** 0.5), known_by, kept)


def linked(held: Sequence[HeldMessages], start: int) -> Mapping[int, ClockOffset]:
    """The recordings that messages or topics lead to from `start`, with what each is off it; `start` among them."""
    found = {start: ClockOffset(0, 0, ())}
    waiting = [start]
    while waiting:
        at = waiting.pop(0)
        for other in range(len(held)):
            link = None if other in found else link_between(held[at], held[other])
            if link is not None:
                found[other] = link.after(found[at])
                waiting.append(other)
    return found


def link_between(first: HeldMessages, second: HeldMessages) -> ClockOffset | None:
    """What is added to the second's times to be on the first's clock; None where they share nothing that tells."""
    topics = [name for name in first.messages if name in second.messages]
    pairs = {name: shared_messages(first.messages[name], second.messages[name]) for name in topics}
    found = {name: shared for name, shared in pairs.items() if shared is not None}
    if found:
        return _by_messages(found)
    goes_on = first.sensors & second.sensors & set(topics)
    if goes_on and all(_is_apart(first.messages[name], second.messages[name]) for name in goes_on):
        return ClockOffset(0, None, (SAME_TOPICS,))
    return None


def _by_messages(found: Mapping[str, SharedMessages]) -> ClockOffset:
    """By the topic with the most messages."""
    best = max(found.values(), key=lambda shared: shared.count)
    if best.stamp_offset_ns:
        return ClockOffset(best.stamp_offset_ns, 0, (SAME_MESSAGES,))
    if abs(best.log_offset_ns) < TRANSPORT_NS:
        return ClockOffset(0, 0, (SAME_MESSAGES,))
    kept = tuple(sorted(name for name, shared in found.items() if shared.stamp_offset_ns == 0))
    return ClockOffset(best.log_offset_ns, best.spread_ns, (SAME_MESSAGES,), kept)


def _is_apart(first: TopicMessages, second: TopicMessages) -> bool:
    """Whether one ends before the other begins, by their log times."""
    one, two = first.log_times_ns, second.log_times_ns
    return bool(one[-1] < two[0] or two[-1] < one[0])
