"""What is told of a joined recording whenever it is opened: whose clock was moved by how much, and what was had twice.

**Conventions.** SYN-520 an offset that was measured, SYN-521 one that was given, SYN-522 messages that two members
hold. SYN-527 and SYN-528 are of `coverage` beside it; SYN-523 … SYN-526 refuse, `stone_recordings.joining.errors`.
"""

from collections.abc import Iterator, Sequence

from stone.findings import Finding
from stone_files.joined_file import GIVEN, REFERENCE, SAME_TOPICS, JoinedMember


def member_findings(members: Sequence[JoinedMember]) -> tuple[Finding, ...]:
    """In the order of the members."""
    reference = next((member.name for member in members if REFERENCE in member.known_by), "the reference")
    return tuple(finding for member in members for finding in _of(member, reference))


def _of(member: JoinedMember, reference: str) -> Iterator[Finding]:
    if REFERENCE not in member.known_by:
        yield _offset_finding(member, reference)
    for topic, count in sorted(member.count_left_out().items()):
        sentence = f"{count} of its messages in {member.name} are also in another file of the run, and used once"
        yield Finding("SYN-522", "info", topic, sentence)


def _offset_finding(member: JoinedMember, reference: str) -> Finding:
    moved = f"its stamps are shifted by {member.offset_ns / 1e9:+.6f} s onto the clock of {reference}"
    if GIVEN in member.known_by:
        return Finding("SYN-521", "info", member.name, f"{moved}, as given by the user; it was not measured")
    if member.known_by == (SAME_TOPICS,):
        sentence = (
            f"it holds topics of {reference}, whose stamps continue: the recorder split the run; nothing is shifted"
        )
        return Finding("SYN-520", "info", member.name, sentence)
    if not member.offset_ns:
        sentence = f"it is on the clock of {reference}, by {' and '.join(member.known_by)}; nothing is shifted"
        return Finding("SYN-520", "info", member.name, sentence)
    error = "" if member.sigma_ns is None else f" ± {member.sigma_ns / 1e6:.2f} ms (standard error)"
    return Finding("SYN-520", "info", member.name, f"{moved}{error}, measured by {' and '.join(member.known_by)}")
