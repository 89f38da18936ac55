"""Findings about the clouds of a LiDAR, from a sample of them: the same for inspection and labelling.

**Conventions.** MSG-303 a wrong byte order, MSG-320 declared sizes that the data refutes. MSG-321 points without a time
of their sweep, MSG-322 sweeps that are not deskewed. TIM-220 points on another clock than the header, TOP-102 no times.
"""

from collections.abc import Iterator, Sequence

from stone.findings import Finding
from stone_recordings.bags.bag import Bag
from stone_recordings.clocks.point_clock import SweepLook, point_clock
from stone_recordings.messages.point_times import ANOTHER_CLOCK, OTHERS, TOO_COARSE

UNTIMED = {
    ANOTHER_CLOCK: "its points are on another clock than the header stamp, and the distance of the two is not constant",
    TOO_COARSE: "its points have dates in four bytes, which are steps of minutes: write eight (float64)",
}
NO_TIME = "its points have no readable time"


def sweep_findings(bag: Bag, topic: str, looks: Sequence[SweepLook]) -> Iterator[Finding]:
    """Yield the findings of the sampled sweeps of a topic."""
    looked = f"of {len(looks)} sampled sweeps"
    swapped = sum(look.is_swapped for look in looks)
    if swapped:
        message = f"{swapped} {looked} are declared big-endian, but are little-endian: they are read as such. "
        yield Finding("MSG-303", "warning", topic, f"{message}Correct the driver's flag.")
    ignored = [look.ignored for look in looks if look.ignored]
    if ignored:
        message = f"{len(ignored)} {looked} contradict their own data, which is read (the first: {ignored[0]})"
        yield Finding("MSG-320", "warning", topic, f"{message}. Correct the driver.")
    yield from _time_findings(bag, topic, [look for look in looks if look.count])


def _time_findings(bag: Bag, topic: str, looks: Sequence[SweepLook]) -> Iterator[Finding]:
    timed, untimed = ([look for look in looks if (look.span_ns is not None) == is_timed] for is_timed in (True, False))
    if looks and not timed:
        why = UNTIMED.get(untimed[0].meaning, NO_TIME)
        sentence = f"{why}; sweeps are not deskewed (a turning robot smears them)"
        yield Finding("TOP-102", "warning", topic, sentence)
    elif untimed:
        why = UNTIMED.get(untimed[0].meaning, NO_TIME)
        sentence = f"{len(untimed)} of {len(looks)} sampled sweeps are not deskewed: {why}"
        yield Finding("MSG-322", "warning", topic, sentence)
    if others := [look for look in timed if look.meaning.startswith(OTHERS)]:
        clock, stamped = point_clock(bag, topic)
    if others and clock is not None:
        modulo = f" (modulo {clock.period_ns / 1e9:.3f} s)" if clock.period_ns else ""
        sentence = (
            f"in {len(others)} of {len(looks)} sampled sweeps, points are on another clock than the header stamp, "
            f"ahead of it by {clock.ahead_ns / 1e9:+.3f} s{modulo}. The {stamped} point of a sweep counts as "
            "simultaneous with its stamp"
        )
        yield Finding("TIM-220", "warning", topic, sentence)
    if odd := [look for look in timed if look.wrapped + look.filled + look.untimed]:
        yield _mistimed(topic, odd, looks)


def _mistimed(topic: str, odd: Sequence[SweepLook], looks: Sequence[SweepLook]) -> Finding:
    """Return MSG-321: how many points of how many sweeps are mistimed, and their treatment."""
    wrapped, filled, dropped = (
        sum(counts) for counts in zip(*((look.wrapped, look.filled, look.untimed) for look in odd), strict=True)
    )
    became = (
        (wrapped, "lie below the stamp in an unsigned field and are read as negative"),
        (filled, "get the time between their neighbours"),
        (dropped, "are left out"),
    )
    treatment = ", ".join(f"{count} {what}" for count, what in became if count)
    sentence = (
        f"{wrapped + filled + dropped} points in {len(odd)} of {len(looks)} sampled sweeps have no time of their "
        f"sweep as it was written: {treatment}"
    )
    return Finding("MSG-321", "warning", topic, sentence)
