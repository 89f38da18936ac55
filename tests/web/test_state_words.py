"""Every state has one word, and pages have no other way to say it."""

import re
from pathlib import Path
from typing import Any, get_args

import pytest

from api.lists import jobs
from api.schemas import rescores, submissions, truths
from api.schemas.sequences import scenes
from services.domain.benchmarks.phases import phases
from services.domain.benchmarks.submissions import states
from web.pages.sequences import MOVING
from web.state_words import STATE_WORDS, state_word

ROOT = Path(__file__).resolve().parents[2]
TEMPLATES = ROOT / "web" / "templates"
FREE = {
    "parts/calibrations.html",
    "calibrations/list.html",
    "calibrations/one.html",
    "people/account.html",
    "parts/first_steps.html",
}
"""Templates whose badges are no states: what changed between calibrations, how many findings, when a token expires,
which steps are done."""
LITERALS: dict[str, Any] = {
    "jobs": jobs.State,
    "submissions": submissions.State,
    "phases": phases.PhaseStatus,
    "rescores": rescores.RescoreState,
    "truths": truths.TruthItem.model_fields["state"].annotation,
    "playbacks": scenes.PlaybackItem.model_fields["state"].annotation,
}
TUPLES: tuple[tuple[str, ...], ...] = (
    states.OPEN,
    states.ENDED,
    MOVING,
    ("empty", "recorded", "labelled"),
    ("received", "registered", "refused"),
    ("queued", "waiting", "delivered", "dropped", "dead"),
    ("open", "paused", "draining"),
)


@pytest.mark.parametrize("name", sorted(LITERALS))
def test_every_state_that_the_api_names_has_a_word(name: str) -> None:
    assert set(get_args(LITERALS[name])) <= set(STATE_WORDS)


def test_every_state_that_the_platform_keeps_has_a_word() -> None:
    assert {state for named in TUPLES for state in named} <= set(STATE_WORDS)


def test_a_state_without_a_word_is_shown_as_it_is() -> None:
    assert state_word("half_way") == "half way"


def test_no_template_writes_a_state_in_its_own_words() -> None:
    badge = re.compile(r'<span class="state" data-state="[^"]*"[^>]*>([^<{]+)<')
    written = {
        (path.relative_to(TEMPLATES).as_posix(), word.strip())
        for path in TEMPLATES.rglob("*.html")
        for word in badge.findall(path.read_text("utf-8"))
    }
    assert {one for one in written if one[0] not in FREE and one[1] not in STATE_WORDS.values()} == set()


def test_the_browsers_words_for_an_upload_are_the_same() -> None:
    text = (ROOT / "web" / "modules" / "upload" / "row.ts").read_text("utf-8")
    said = dict(re.findall(r'^  (\w+): "([^"]+)",$', text[text.index("SAID") : text.index("/** The words")], re.M))
    assert set(said) & set(STATE_WORDS)
    assert {key: said[key] for key in set(said) & set(STATE_WORDS)} == {
        key: STATE_WORDS[key] for key in set(said) & set(STATE_WORDS)
    }
