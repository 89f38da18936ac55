"""The text of an event, written when it is sent, limited to what its reader may see at that time.

**Conventions.** A message is a sentence and a page, without scores, labels or files: the page shows them to permitted
readers. `data` is for programs and contains no more. Untrusted texts are quoted on one line of at most `LONGEST_NAME`
characters; markup and mentions of chat servers (`@channel`, `<!here>`) are defused.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from sqlalchemy.orm import Session

from services.runtime.notifications import events
from services.runtime.notifications.events import STOPPED, TOLD_FAILED
from services.runtime.orm import Benchmark, Job, NotificationEvent, Phase, SequenceRow, SubmissionRow
from stone.errors import one_line
from stone_base.counts import counted

LONGEST_NAME = 120
GIB = 2**30
HARMLESS = str.maketrans({"<": "‹", ">": "›", "@": "＠", "*": "∗", "`": "'", "[": "(", "]": ")", "|": "¦"})


@dataclass(frozen=True)
class EventWords:
    """A sentence, and the path of the page with details."""

    text: str
    path: str
    data: Mapping[str, Any] = field(default_factory=dict)


def message_of(session: Session, event: NotificationEvent) -> EventWords | None:
    """Return the text of the event, or None if its subject was deleted."""
    return WORDS[event.kind](session, event)


def _quote(text: str) -> str:
    """Return an untrusted text, quoted for use in a sentence."""
    return f"“{one_line(text)[:LONGEST_NAME].translate(HARMLESS)}”"


def _run(session: Session, event: NotificationEvent) -> EventWords | None:
    run = session.get(Job, event.subject_id)
    if run is None:
        return None
    path, of = "/account#notifications", ""
    if run.sequence_id is not None:
        sequence = session.get(SequenceRow, run.sequence_id)
        if sequence is None or sequence.deleted_ns is not None:
            return None
        path, of = f"/sequences/{sequence.id}", f" of {_quote(sequence.name)}"
    what, data = f"{TOLD_FAILED[run.kind].capitalize()}{of}", {"run_id": run.id, "kind": run.kind}
    if event.kind == events.RUN_DONE:
        return EventWords(f"{what} is done.", path, data)
    failure = one_line(str(event.facts["failure"])).translate(HARMLESS)
    if event.facts["code"] == STOPPED:
        text = f"{what} was cancelled by an administrator: {failure}"
        return EventWords(text, path, {**data, "code": STOPPED})
    return EventWords(f"{what} failed ({event.facts['code']}): {failure}", path, {**data, "code": event.facts["code"]})


def _labels(session: Session, event: NotificationEvent) -> EventWords | None:
    sequence = session.get(SequenceRow, event.subject_id)
    if sequence is None or sequence.deleted_ns is not None:
        return None
    first = one_line(str(event.facts["message"]))[:500].translate(HARMLESS)
    text = f"Labels of {_quote(sequence.name)} are unreliable ({event.facts['code']}): {first}"
    data = {"sequence_id": sequence.id, "code": event.facts["code"], "page": f"/codes/{event.facts['code']}"}
    return EventWords(text, f"/sequences/{sequence.id}", data)


def _submission(session: Session, event: NotificationEvent) -> EventWords | None:
    submission = session.get(SubmissionRow, event.subject_id)
    phase = None if submission is None else _place(session, submission.phase_id)
    if submission is None or phase is None:
        return None
    ends = {
        events.SUBMISSION_SCORED: "is scored",
        events.SUBMISSION_INVALID: "is invalid",
        events.SUBMISSION_FAILED: "could not be scored",
    }
    text = f"The submission {_quote(submission.method)} to {phase[0]} {ends[event.kind]}."
    return EventWords(text, f"/submissions/{submission.id}", {"submission_id": submission.id, "phase": phase[0]})


def _phase(session: Session, event: NotificationEvent) -> EventWords | None:
    phase = _place(session, event.subject_id)
    if phase is None:
        return None
    text = f"The phase {phase[0]} is {'open' if event.kind == events.PHASE_OPENED else 'closed'}."
    return EventWords(text, phase[1], {"phase_id": event.subject_id, "phase": phase[0]})


def _quota(session: Session, event: NotificationEvent) -> EventWords | None:
    facts = event.facts
    if facts["what"] == "storage":
        used, limit = (facts[name] / GIB for name in ("used_bytes", "limit_bytes"))
        return EventWords(
            f"Your storage is nearly full: {used:.1f} of {limit:.1f} GiB are used. Delete recordings or exports that "
            "you do not need.",
            "/account",
            dict(facts),
        )
    phase = _place(session, event.subject_id)
    if phase is None:
        return None
    return EventWords(
        f"Your team has {counted(facts['left'], 'submission')} left in {phase[0]}.", phase[1], dict(facts)
    )


def _webhook_disabled(_session: Session, _event: NotificationEvent) -> EventWords | None:
    text = "Your webhook was disabled because its deliveries failed for days. Set it again on your account page."
    return EventWords(text, "/account#notifications")


def _verification(_session: Session, _event: NotificationEvent) -> EventWords | None:
    text = (
        "Your address was entered to receive notifications. To confirm it, sign in and open the link. If you did not "
        "enter it, ignore this e-mail."
    )
    return EventWords(text, "/account")


def _place(session: Session, phase_id: str) -> tuple[str, str] | None:
    """Return `benchmark/phase`, names that need no quotes, and its page."""
    phase = session.get(Phase, phase_id)
    benchmark = None if phase is None else session.get(Benchmark, phase.benchmark_id)
    if phase is None or benchmark is None:
        return None
    name = f"{benchmark.name}/{phase.name}"
    return name, f"/benchmarks/{name}"


WORDS: Mapping[str, Callable[[Session, NotificationEvent], EventWords | None]] = {
    events.RUN_DONE: _run,
    events.RUN_FAILED: _run,
    events.LABELS_UNUSABLE: _labels,
    events.SUBMISSION_SCORED: _submission,
    events.SUBMISSION_INVALID: _submission,
    events.SUBMISSION_FAILED: _submission,
    events.PHASE_OPENED: _phase,
    events.PHASE_CLOSED: _phase,
    events.QUOTA_LOW: _quota,
    events.WEBHOOK_DISABLED: _webhook_disabled,
    events.EMAIL_VERIFICATION: _verification,
}
