"""A participant who asks for everything is told nothing of a hidden phase: no byte of its labels, no digest, no
count of voxels, no exact score, nothing per sequence.

**Conventions.** Two proofs on one world. *Nothing is found*: what is hidden is known (canary grids, digests, blob keys,
exact scores) and is looked for in every answer. *Nothing depends on it*: all that is hidden is changed in the rows, all
is asked again, and every answer is byte for byte what it was; that sees also what no search would know how to look for.
The hidden phase runs. The callers are the captain of a scored team, whose the jobs of its submissions are and who
sees another team's entries as others do, and somebody in no team.

Timing tells nothing either. Counting a frame is loops over all words of its bit planes (`stone/scoring/bitplanes.py`),
without a branch on a voxel: how many depends on the grid's shape alone, which
`test_counting_takes_no_branch_on_what_it_counts` asserts. Unpacking a frame of the truth takes a time of its own, but
the same for every submission, so that no choice of predictions turns it into an answer about a voxel; what is wrong
with a frame is found by what is in the submission. Intervals are drawn equally often from the same seed.

Catches alone a route, of all there are, that tells what is hidden.
"""

import ast
import inspect
import json
import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import select

from api.main import make_api
from api.routes import statistics
from services.domain.datasets.composition_figure import composition_png
from services.runtime.orm import GroundTruthRow
from services.runtime.platform import Platform
from services.runtime.settings import ApiSettings
from stone.scoring import bitplanes
from testing.api.serving import Person, client_of
from tests.api.crawling import Answer, Crawl
from tests.api.hidden_stage import (
    EXPORTED,
    STRANGER,
    Stage,
    change_what_is_hidden,
    hidden_label_sets,
    hidden_scores,
    known,
    staged,
)

pytestmark = pytest.mark.whole

UNBOUND = ApiSettings(requests_per_minute=10**7)
OTHERS = (
    "recording_id",
    "export_id",
    "calibration_id",
    "comparison_id",
    "label_set_id",
    "sequence_id",
    "token",
    "submission_id",
)
NOBODYS = "e" * 32
TELLING_THE_TIME = ("/readyz", "/quota", "/tokens")
VOLATILE = {"date", "x-request-id", "ratelimit-remaining", "ratelimit-reset"}


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory, _sqlite_template: Path) -> Iterator[Stage]:
    """Figures are drawn once for each record that they show."""
    drawn: dict[str, bytes] = {}

    def drawn_once(*shown: Any) -> bytes:
        key = json.dumps(shown, sort_keys=True)
        drawn[key] = drawn.get(key) or composition_png(*shown)
        return drawn[key]

    with pytest.MonkeyPatch.context() as patch, staged(tmp_path_factory.mktemp("crawl"), _sqlite_template) as made:
        patch.setattr(statistics, "composition_png", drawn_once)
        yield made


@pytest.fixture(scope="module")
def document(stage: Stage) -> dict[str, Any]:
    described: dict[str, Any] = make_api(stage.world.platform).openapi()
    return described


def unbound(platform: Platform) -> Platform:
    """The platform for callers in a hurry."""
    return replace(platform, settings=platform.settings.model_copy(update={"api": UNBOUND}))


def _crawled(stage: Stage, caller: Person, document: dict[str, Any]) -> dict[str, Answer]:
    with client_of(unbound(stage.world.platform), caller) as client:
        return Crawl(client, document, known(stage.world)).run()


@pytest.fixture(scope="module")
def crawls(stage: Stage, document: dict[str, Any]) -> dict[str, dict[str, Answer]]:
    return {name: _crawled(stage, caller, document) for name, caller in stage.callers.items()}


def test_every_route_answers_and_none_fails(crawls: dict[str, dict[str, Answer]]) -> None:
    answers = [answer for crawl in crawls.values() for answer in crawl.values()]
    assert [answer.asked for answer in answers if answer.status >= 500 and "readyz" not in answer.asked] == []
    for part in ("leaderboard", "/results", "/provenance", "/events", "/logs", "/validation-report", "/statistics"):
        assert any(part in answer.asked and answer.status == 200 for answer in answers), part


def test_nothing_hidden_is_found_in_any_answer(stage: Stage, crawls: dict[str, dict[str, Answer]]) -> None:
    told = {
        f"{caller}: {answer.asked}": found
        for caller, crawl in crawls.items()
        for answer in crawl.values()
        if (found := stage.secrets.found_in(answer.heads(), answer.body))
    }
    assert told == {}


def test_an_administrator_is_told_so_the_search_sees(stage: Stage) -> None:
    """Labels, digests, exact scores and counts of the hidden phase, each where it may be told."""
    with stage.world.platform.database.reading() as session:
        label_set = hidden_label_sets(session, stage.world)[0]
        entry = hidden_scores(session, stage.world)[0].submission_id
    token = next(iter(stage.world.truth("test")))
    routes = (
        f"/frames/{token}/labels.npz", f"/frames/{token}", f"/submissions/{entry}/results",
        f"/submissions/{entry}/results/breakdowns?by=sequence", "/statistics", f"/sequences/{label_set.sequence_id}",
    )  # fmt: skip
    with client_of(unbound(stage.world.platform), stage.world.administrator) as client:
        for route in routes:
            answer = client.get(f"/api/v1{route}")
            assert answer.status_code == 200
            assert stage.secrets.found_in(str(answer.headers), answer.content), route


def test_what_is_hidden_is_answered_like_what_does_not_exist(stage: Stage, document: dict[str, Any]) -> None:
    """Status, headers and sentence, but for the id."""
    with stage.world.platform.database.reading() as session:
        hidden = hidden_label_sets(session, stage.world)[0].sequence_id
        job = (
            session.scalars(select(GroundTruthRow.job_id).where(GroundTruthRow.phase_id == stage.world.test)).one()
            or ""
        )
    token = next(iter(stage.world.truth("test")))
    with client_of(unbound(stage.world.platform), stage.world.member) as client:
        for kind, subject in (("sequence_id", hidden), ("token", token), ("job_id", job)):
            others = {one: [NOBODYS] for one in OTHERS} | {"path": [EXPORTED], "name": ["bev.png"]}
            others |= {"tile_name": ["0_-1"], "channel": ["CAM_FRONT"]}
            others |= {"benchmark_name": [stage.world.benchmark], "phase_name": ["test", "val"]}
            there, absent = (
                Crawl(client, _about(document, kind), others | {kind: [one]}) for one in (subject, STRANGER)
            )
            pairs = zip(there.run().values(), absent.run().values(), strict=True)
            assert [(a.asked, a.status) for a, b in pairs if _plain(a, subject) != _plain(b, STRANGER)] == []
            asked = {answer.status for answer in there.answers.values() if subject in answer.asked}
            assert asked == ({403, 404} if kind == "job_id" else {404})


def test_no_answer_depends_on_what_is_hidden(
    stage: Stage, crawls: dict[str, dict[str, Answer]], document: dict[str, Any]
) -> None:
    with stage.world.platform.database.transaction() as session:
        change_what_is_hidden(session, stage.world)
    before, later = crawls["a captain"], _crawled(stage, stage.callers["a captain"], document)
    assert later.keys() == before.keys()
    told = [asked for asked, answer in before.items() if _lasting(answer) != _lasting(later[asked])]
    assert [asked for asked in told if not asked.endswith(TELLING_THE_TIME)] == []


def _lasting(answer: Answer) -> tuple[int, dict[str, str], bytes]:
    """The answer without what tells when it was asked."""
    return answer.status, {name: one for name, one in answer.headers.items() if name not in VOLATILE}, answer.body


def _plain(answer: Answer, subject: str) -> tuple[int, dict[str, str], bytes]:
    status, headers, body = _lasting(answer)
    return status, headers, body.replace(subject.encode(), b"<id>")


def _about(document: Mapping[str, Any], parameter: str) -> dict[str, Any]:
    """The paths that hold this parameter."""
    return {**document, "paths": {path: one for path, one in document["paths"].items() if f"{{{parameter}}}" in path}}


@pytest.mark.parametrize("kernel", ["_count", "_joint", "_drivable", "_exact", "_pack"])
def test_counting_takes_no_branch_on_what_it_counts(kernel: str) -> None:
    """Loops over ranges and nothing else: no condition, no early end, no choice."""
    source = ast.parse(textwrap.dedent(inspect.getsource(getattr(bitplanes, kernel).py_func)))
    branches = (ast.If, ast.IfExp, ast.While, ast.BoolOp, ast.Break, ast.Continue, ast.Match, ast.Try)
    assert not [node for node in ast.walk(source) if isinstance(node, branches)]
    loops = [node for node in ast.walk(source) if isinstance(node, ast.For)]
    assert all(isinstance(loop.iter, ast.Call) and ast.unparse(loop.iter.func) == "range" for loop in loops)
