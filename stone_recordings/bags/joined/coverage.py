"""How the members of a joined recording lie in time, by their log times on one clock.

**Conventions.** SYN-527 a member that does not cover what the reference does, SYN-528 a gap where one member ends and
the next goes on with its topics.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from stone.findings import Finding
from stone_files.joined_file import REFERENCE, SAME_TOPICS, JoinedMember
from stone_recordings.bags.joined.moved_bag import MovedBag

LEAST_MISSING_NS = 1_000_000_000
GAP_PERIODS = 2.5


@dataclass(frozen=True, eq=False)
class _Span:
    name: str
    is_reference: bool
    times_ns: dict[str, NDArray[np.int64]]

    @property
    def start_ns(self) -> int:
        return min(int(times[0]) for times in self.times_ns.values())

    @property
    def end_ns(self) -> int:
        return max(int(times[-1]) for times in self.times_ns.values())


def coverage_findings(members: Sequence[JoinedMember], bags: Sequence[MovedBag]) -> tuple[Finding, ...]:
    """In order of the members, then of time."""
    spans = [_span(member, bag) for member, bag in zip(members, bags, strict=True)]
    spans = [span for span in spans if span.times_ns]
    return (*_missing(spans), *_gaps(spans))


def _span(member: JoinedMember, bag: MovedBag) -> _Span:
    is_reference = member.known_by in ((REFERENCE,), (SAME_TOPICS,))
    times = {topic.name: bag.log_times_ns(topic.name) for topic in bag.topics if topic.count}
    return _Span(member.name, is_reference, times)


def _missing(spans: Sequence[_Span]) -> Iterator[Finding]:
    reference = [span for span in spans if span.is_reference]
    if not reference:
        return
    start_ns, end_ns = min(span.start_ns for span in reference), max(span.end_ns for span in reference)
    for span in spans:
        late_ns, early_ns = span.start_ns - start_ns, end_ns - span.end_ns
        if not span.is_reference and max(late_ns, early_ns) > LEAST_MISSING_NS:
            missing = [
                f"the {which} {min(ns, end_ns - start_ns) / 1e9:.1f} s"
                for which, ns in (("first", late_ns), ("last", early_ns))
                if ns > LEAST_MISSING_NS
            ]
            sentence = f"it has no messages in {' and '.join(missing)} of the run: frames there lack its sensors"
            yield Finding("SYN-527", "warning", span.name, sentence)


def _gaps(spans: Sequence[_Span]) -> Iterator[Finding]:
    """Where topics that two members hold stop for longer than they pause."""
    told = set[tuple[str, str]]()
    for topic in sorted({name for span in spans for name in span.times_ns}):
        holding = sorted((span for span in spans if topic in span.times_ns), key=lambda span: span.times_ns[topic][0])
        for one, two in pairwise(holding):
            before, after = one.times_ns[topic], two.times_ns[topic]
            gap_ns, steps_ns = int(after[0] - before[-1]), np.diff(before)
            if (one.name, two.name) in told or len(steps_ns) < 2 or gap_ns <= GAP_PERIODS * float(np.median(steps_ns)):
                continue
            told.add((one.name, two.name))
            sentence = f"between its last message in {one.name} and its first in {two.name} lie {gap_ns / 1e9:.3f} s"
            yield Finding("SYN-528", "warning", topic, sentence)
