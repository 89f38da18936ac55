"""A run that another version of the code began is begun again once, or left alone, or refused with its reason."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import select
from sqlalchemy.orm import Session

from services.domain.sequences.processing import PROCESS, delete_sequence
from services.domain.sequences.restart import (
    MOST_RESTARTS,
    RESTARTS,
    RestartedTooOftenError,
    arguments_of_run,
    begin_again,
)
from services.ingest.queue_handlers import handlers
from services.runtime.code_version import code_version
from services.runtime.jobs.claims import claim
from services.runtime.jobs.control import cancel, retry, set_mode
from services.runtime.jobs.errors import JobCancelledError
from services.runtime.jobs.execution import run_next
from services.runtime.orm import Job, JobAttempt
from services.runtime.platform import Platform
from testing.refusals import refused_as
from testing.worlds.runs import Brought, Said
from tests.services.domain.sequences.test_processing import ended, ready_on
from tests.services.runtime.jobs.steps import act

RELEASED = "0.1.0"  # how releases were named before their sources were


@pytest.fixture
def ready(platform: Platform, tmp_path: Path) -> Brought:
    return ready_on(platform, tmp_path)


def begun_before(ready: Brought, **arguments: Any) -> str:
    """A run of another version with these arguments beside what was asked for."""
    root_id = ready.process(profile="local", parameters={"surface.min_frames": 2}, odometry_topic="/odom")
    with ready.platform.database.transaction() as session:
        run = session.get_one(Job, root_id)
        run.arguments = {**run.arguments, "recipe": "0" * 64, "code_version": RELEASED, **arguments}
    return root_id


def again(ready: Brought, root_id: str) -> str | None:
    with ready.platform.database.transaction() as session:
        run = begin_again(session, root_id)
        return run.id if run else None


def attempt_at(ready: Brought, root_id: str) -> Said:
    return Said(ready.jobs(root_id)[1])


def runs(ready: Brought) -> list[Job]:
    with ready.platform.database.reading() as session:
        return list(session.scalars(select(Job).where(Job.kind == PROCESS).order_by(Job.id)))


def test_of_jobs_that_ask_at_once_one_begins_a_run_of_the_same_request(platform_on: Platform, tmp_path: Path) -> None:
    ready = ready_on(platform_on, tmp_path)
    root_id = begun_before(ready)
    assert act(ready.platform, claim, "ingest") is not None
    with ThreadPoolExecutor(8) as pool:
        (new_id,) = [begun for begun in pool.map(lambda _: again(ready, root_id), range(16)) if begun]
    old, new = runs(ready)
    assert (old.id, old.state, new.id, new.state) == (root_id, "cancelled", new_id, "queued")
    assert new_id in old.cancel_reason
    changed = {"recipe", "code_version", RESTARTS}
    assert {name for name in new.arguments if new.arguments[name] != old.arguments.get(name)} == changed
    assert (new.arguments["code_version"], new.arguments[RESTARTS]) == (code_version("labels"), 1)
    assert [job.state for job in ready.jobs(root_id)] == ["cancelled", "cancelled"]
    with ready.platform.database.reading() as session:
        assert session.scalars(select(JobAttempt.outcome)).all() == ["cancelled"]


def test_its_jobs_are_told_why_they_end_and_a_run_of_this_version_goes_on(ready: Brought) -> None:
    root_id = begun_before(ready)
    for _ in range(2):
        with pytest.raises(JobCancelledError):
            arguments_of_run(ready.platform, attempt_at(ready, root_id))
    _, new = runs(ready)
    assert arguments_of_run(ready.platform, attempt_at(ready, new.id)) == new.arguments
    assert len(runs(ready)) == 2


@pytest.mark.parametrize(
    "act",
    [
        lambda session, ready, root_id: cancel(session, root_id, "not wanted"),
        lambda session, ready, root_id: (claim(session, "ingest"), cancel(session, root_id, "not wanted")),
        lambda session, ready, root_id: delete_sequence(session, ready.sequence()),
    ],
    ids=["cancelled", "stopping", "deleted"],
)
def test_what_nobody_wants_any_more_is_left_alone(
    ready: Brought, act: Callable[[Session, Brought, str], object]
) -> None:
    root_id = begun_before(ready)
    with ready.platform.database.transaction() as session:
        act(session, ready, root_id)
    (before,) = runs(ready)
    assert again(ready, root_id) is None
    (after,) = runs(ready)
    assert (after.state, after.cancel_reason, after.revision) == (before.state, before.cancel_reason, before.revision)
    with pytest.raises(JobCancelledError, match=r"not wanted|its sequence was deleted"):
        arguments_of_run(ready.platform, attempt_at(ready, root_id))


def test_deleting_the_sequence_and_beginning_again_at_once_leave_no_run_alive(
    platform_on: Platform, tmp_path: Path
) -> None:
    ready = ready_on(platform_on, tmp_path)
    root_id = begun_before(ready)

    def bury() -> None:
        with ready.platform.database.transaction() as session:
            delete_sequence(session, ready.sequence())

    with ThreadPoolExecutor(4) as pool:
        acts: list[Callable[[], object]] = [lambda: again(ready, root_id), bury, lambda: again(ready, root_id)]
        for done in [pool.submit(act) for act in acts]:
            done.result(timeout=300)
    assert {run.state for run in runs(ready)} == {"cancelled"}
    assert len(runs(ready)) <= 2


def test_a_queue_that_takes_nothing_new_fails_the_run_with_the_way_out(ready: Brought) -> None:
    root_id = begun_before(ready)
    act(ready.platform, set_mode, "ingest", "draining")
    assert run_next(ready.platform, "ingest", handlers(ready.platform))
    (run,) = runs(ready)
    assert (run.id, run.state, run.failure_code) == (root_id, "failed", "code_changed")


def test_choices_that_this_version_refuses_fail_the_run_with_their_reason(ready: Brought) -> None:
    root_id = begun_before(ready, parameters={"surface.width_m": 0.1})
    with refused_as("bad_parameter"):
        again(ready, root_id)
    assert run_next(ready.platform, "ingest", handlers(ready.platform))
    (run,) = runs(ready)
    assert (run.state, run.failure_code) == ("failed", "bad_parameter")


def test_versions_that_serve_at_once_do_not_begin_it_again_for_ever(ready: Brought) -> None:
    root_id = begun_before(ready, **{RESTARTS: MOST_RESTARTS})
    with pytest.raises(RestartedTooOftenError):
        again(ready, root_id)
    with refused_as("code_changed"):
        arguments_of_run(ready.platform, attempt_at(ready, root_id))
    assert [run.state for run in runs(ready)] == ["queued"]


def test_an_old_run_that_is_retried_beside_a_newer_one_says_so(ready: Brought) -> None:
    root_id = begun_before(ready)
    act(ready.platform, cancel, root_id, "")
    newer_id = ready.process()
    act(ready.platform, retry, root_id, 3)
    with refused_as("code_changed", match=newer_id):
        arguments_of_run(ready.platform, attempt_at(ready, root_id))


def test_labels_that_this_version_has_made_are_not_made_again(ready: Brought) -> None:
    made_id = ready.process(profile="local", parameters={"surface.min_frames": 2}, odometry_topic="/odom")
    ended(ready, made_id)
    other_id = ready.process()
    with ready.platform.database.transaction() as session:
        run = session.get_one(Job, other_id)
        kept = session.get_one(Job, made_id).arguments
        run.arguments = {**kept, "recipe": "0" * 64, "code_version": RELEASED}
    assert again(ready, other_id) == made_id
    assert ready.job(made_id).arguments == kept
    assert [run.state for run in runs(ready)] == ["succeeded", "cancelled"]
