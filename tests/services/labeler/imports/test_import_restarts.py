"""An import that was cut short goes on where it was, or anew where what it had is of no use any more."""

import pytest

from services.domain.imports.errors import ExistingSequencesError
from services.domain.imports.requests import PUBLISH_IMPORT, SCENE
from services.runtime.jobs.control import cancel, retry
from services.runtime.jobs.specs import Attempt, Handler, Outcome
from services.runtime.orm import (
    Job,
)
from services.runtime.store.workspace import Workspace
from testing.worlds.brought_datasets import BroughtDataset, counts_of
from testing.worlds.runs import run_all

FRAMES = 6


def test_a_fault_in_the_last_scene_leaves_nothing_and_the_others_are_not_done_again(brought: BroughtDataset) -> None:
    platform, done = brought.platform, list[int]()

    def wrap(kind: str, handler: Handler) -> Handler:
        def run(attempt: Attempt) -> Outcome:
            if attempt.arguments["scene"] == 2 and done.count(2) == 0:
                done.append(2)
                raise ExistingSequencesError(["a fault of this scene"])
            done.append(attempt.arguments["scene"])
            return handler(attempt)

        return run if kind == SCENE else handler

    run_all(platform, wrap=wrap)
    assert (brought.run().state, brought.run().failure_code) == ("failed", "sequences_exist")
    counts = counts_of(platform, brought.owner_id)
    assert (counts["sequences"], counts["label_sets"], counts["labelled_frames"]) == (0, 0, 0)
    with platform.database.transaction() as session:
        retry(session, brought.run().id, 3)
    run_all(platform, wrap=wrap)
    assert brought.run().state == "succeeded"
    assert done == [0, 1, 2, 2], "a scene that is done is not done again"
    assert counts_of(platform, brought.owner_id)["labelled_frames"] == FRAMES


def test_a_cancelled_import_goes_on_where_it_was(brought: BroughtDataset) -> None:
    platform, done = brought.platform, list[int]()

    def wrap(kind: str, handler: Handler) -> Handler:
        def run(attempt: Attempt) -> Outcome:
            done.append(attempt.arguments["scene"])
            if done == [0, 1]:
                with platform.database.transaction() as session:
                    cancel(session, attempt.root_id, "")
            return handler(attempt)

        return run if kind == SCENE else handler

    run_all(platform, wrap=wrap)
    assert brought.run().state == "cancelled"
    with platform.database.transaction() as session:
        retry(session, brought.run().id, 3)
    run_all(platform, wrap=wrap)
    assert brought.run().state == "succeeded"
    assert done.count(0) == 1


@pytest.mark.parametrize("done", [0, 1, 2, 4])
def test_a_run_of_another_version_is_begun_again_and_ends_as_any(brought: BroughtDataset, done: int) -> None:
    """Catches alone a dataset half of which was imported by the code before an upgrade."""
    platform = brought.platform
    attempts = list[str]()

    def wrap(kind: str, handler: Handler) -> Handler:
        def run(attempt: Attempt) -> Outcome:
            if len(attempts) == done:
                with platform.database.transaction() as session:
                    row = session.get_one(Job, attempt.root_id)
                    row.arguments = {**row.arguments, "code_version": "0.1.0"}
            attempts.append(kind)
            return handler(attempt)

        return run

    old_id = brought.run().id
    run_all(platform, wrap=wrap)
    new = brought.run()
    with platform.database.reading() as session:
        old = session.get_one(Job, old_id)
    assert (old.state, new.state, new.failure) == ("cancelled", "succeeded", "")
    assert new.id != old_id
    assert new.id in old.cancel_reason
    counts = counts_of(platform, brought.owner_id)
    assert (counts["sequences"], counts["labelled_frames"], counts["imported_files"]) == (3, FRAMES, 0)


@pytest.mark.parametrize(("kind", "number"), [(SCENE, 1), (PUBLISH_IMPORT, 0)])
def test_a_run_whose_files_are_gone_is_begun_again(brought: BroughtDataset, kind: str, number: int) -> None:
    platform, seen = brought.platform, list[str]()

    def wrap(of: str, handler: Handler) -> Handler:
        def run(attempt: Attempt) -> Outcome:
            if seen.count(kind) == number:
                Workspace(platform.store, platform.settings, attempt.root_id).remove()
            seen.append(of)
            return handler(attempt)

        return run if of == kind else handler

    run_all(platform, wrap=wrap)
    assert (brought.run().state, brought.run().failure) == ("succeeded", "")
    assert counts_of(platform, brought.owner_id)["labelled_frames"] == FRAMES
