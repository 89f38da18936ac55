"""The runbook is real: what asks the platform is run, what is typed into a cluster names what the chart makes."""

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from services.runtime.database.transactions import Database
from services.runtime.jobs.claims import claim
from services.runtime.jobs.completion import Failure, lose
from services.runtime.jobs.control import set_mode
from services.runtime.jobs.enqueue import enqueue
from services.runtime.jobs.specs import Context, JobSpec
from services.runtime.orm import Job, Token
from services.runtime.platform import Platform
from services.runtime.settings import BrokerSettings
from testing.api.serving import Person, person, serving

ROOT = Path(__file__).resolve().parents[2]
PAGES = ROOT / "docs" / "operations"
OURS = (
    "runbook", "disk-full", "lost-redis", "stuck-queue", "poisoned-job", "full-quota", "lost-objects", "upgrade",
    "keys",
)  # fmt: skip
TRIED = ("disk-full", "stuck-queue", "keys")  # by a test of its own, with what comes of it
ROLES = {"api", "ingest", "labeler", "eval", "beat", "redis", "prepare", "backup", "restore"}
Trouble = tuple[Platform, Person, str]
FENCED = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def text_of(page: str) -> str:
    return (PAGES / f"{page}.md").read_text("utf-8")


def asked(page: str) -> str:
    """Return the lines of a page that send requests to the platform, after the runbook's preparation."""
    begin, *how_it_is = (block for language, block in FENCED.findall(text_of("runbook")) if language == "sh")
    own = (
        how_it_is
        if page == "runbook"
        else [block for language, block in FENCED.findall(text_of(page)) if language == "sh"]
    )
    return "\n".join(["set -euo pipefail", begin, *own])


def shell(script: str, url: str, administrator: Person, job_id: str = "") -> str:
    """Return what the script prints, run by an administrator of the platform at `url`; `job_id` is the page's `JOB`."""
    bash = shutil.which("bash")
    if bash is None or shutil.which("curl") is None or shutil.which("python3") is None:
        pytest.skip("the runbook is typed into bash, with curl and python3")
    environment = {
        "PATH": f"{Path(sys.executable).parent}:/usr/local/bin:/usr/bin:/bin",
        "STONE_URL": url,
        "STONE_TOKEN": administrator.secret,
        "JOB": job_id,
    }
    outcome = subprocess.run([bash, "-c", script], check=False, capture_output=True, text=True, env=environment)
    assert outcome.returncode == 0, f"{outcome.stdout}\n{outcome.stderr}\n{script}"
    return outcome.stdout


def queued(database: Database, owner: Person, kind: str) -> None:
    with database.transaction() as session:
        enqueue(session, JobSpec(kind, {}), Context(owner.user_id))


def job_of(platform: Platform, kind: str) -> str:
    with platform.database.reading() as session:
        return session.query(Job).filter(Job.kind == kind).one().id


@pytest.fixture
def troubled(platform: Platform, redis_url: str) -> Iterator[Trouble]:
    """A platform in trouble: a job that runs, one that died of a full store, a queue that is paused."""
    administrator, ada = person(platform, "administrator"), person(platform, "curator", "ada")
    for kind in ("labeler.surface", "eval.score"):
        queued(platform.database, ada, kind)
    for _ in range(platform.settings.jobs.max_attempts):
        with platform.database.transaction() as session:
            dying = claim(session, "eval")
        with platform.database.transaction() as session:
            assert dying is not None
            lose(session, dying, Failure("store_full", "no space left"))
    with platform.database.transaction() as session:
        claim(session, "labeler")
        set_mode(session, "labeler", "paused")
    settings = platform.settings.model_copy(update={"broker": BrokerSettings(redis_url)})
    with serving(replace(platform, settings=settings)) as url:
        yield platform, administrator, url


@pytest.mark.parametrize("page", [page for page in OURS if page not in TRIED])
def test_every_line_that_asks_the_platform_can_be_pasted(troubled: tuple[Platform, Person, str], page: str) -> None:
    platform, administrator, url = troubled
    shell(asked(page), url, administrator, job_of(platform, "eval.score"))


def test_what_died_of_a_full_disk_is_tried_again_at_once(troubled: Trouble) -> None:
    platform, administrator, url = troubled
    shell(asked("disk-full"), url, administrator)
    with platform.database.reading() as session:
        assert {job.state for job in session.query(Job).filter(Job.kind == "eval.score")} == {"queued"}


def test_a_paused_queue_is_opened_and_what_hung_is_begun_anew(troubled: Trouble) -> None:
    platform, administrator, url = troubled
    printed = shell(asked("stuck-queue"), url, administrator, job_of(platform, "labeler.surface"))
    assert re.search(r"labeler\s+open", printed), printed
    with platform.database.reading() as session:
        [job] = session.query(Job).filter(Job.kind == "labeler.surface")
        assert (job.state, job.attempts_left) == ("queued", platform.settings.jobs.max_attempts)


def test_after_a_break_in_nobody_s_token_is_left_but_the_one_that_asked(troubled: Trouble) -> None:
    platform, administrator, url = troubled
    for _ in range(3):
        person(platform, "participant")
    shell(asked("keys"), url, administrator)
    with platform.database.reading() as session:
        assert [token.user_id for token in session.query(Token)] == [administrator.user_id]


def test_what_is_typed_into_a_cluster_names_what_the_chart_makes() -> None:
    known = set(json.loads((ROOT / "deploy/kubernetes/stone/values.schema.json").read_text())["properties"])
    for page in OURS:
        for name in re.findall(r"(?:deploy|job|cronjob)/stone-([a-z]+)", text_of(page)):
            assert name in ROLES, (page, name)
        for name in re.findall(r"component!?=([a-z]+)", text_of(page)):
            assert name in ROLES, (page, name)
        for value in re.findall(r"--set ([a-zA-Z]+)", text_of(page)):
            assert value in known, (page, value)
