"""Jobs that write files stop at the reserve of the disk; jobs that free bytes or only write rows continue."""

from dataclasses import replace
from time import monotonic, sleep

import pytest

from services.runtime.jobs import execution
from services.runtime.jobs.specs import Attempt, Outcome
from services.runtime.platform import Platform
from services.runtime.store.free_space import FreeSpace, StorageFullError
from tests.services.runtime.jobs.steps import a_job, an_owner, job, run_all, succeed


def with_reserve(platform: Platform, reserve_bytes: int) -> Platform:
    store = replace(platform.settings.store, reserve_bytes=reserve_bytes)
    return replace(platform, settings=platform.settings.model_copy(update={"store": store}))


@pytest.mark.parametrize("kind", ["ingest.ok", "labeler.ok"])
def test_a_job_that_writes_files_waits_and_then_fails_by_the_code_of_the_reserve(platform: Platform, kind: str) -> None:
    full = with_reserve(platform, 2**62)
    job_id = a_job(full, an_owner(full), kind)
    assert run_all(full) == platform.settings.jobs.max_attempts
    failed = job(full, job_id)
    assert (failed.state, failed.failure_code) == ("failed", "storage_full")
    assert "STONE_STORE__RESERVE_BYTES" in failed.failure
    assert str(full.settings.root) not in failed.failure


def test_a_job_that_writes_rows_alone_goes_on(platform: Platform) -> None:
    full = with_reserve(platform, 2**62)
    job_id = a_job(full, an_owner(full), "eval.ok")
    run_all(full, {"eval.ok": succeed}, ("eval",))
    assert job(full, job_id).state == "succeeded"


def test_a_job_under_way_is_stopped_as_half_of_the_reserve_is_gone(
    platform: Platform, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick = replace(platform.settings.jobs, progress_s=0.01, heartbeat_s=0.01, max_attempts=1)
    kept = with_reserve(replace(platform, settings=platform.settings.model_copy(update={"jobs": quick})), 1 << 20)
    seen: list[int] = []

    def work(attempt: Attempt) -> Outcome:
        monkeypatch.setattr(execution, "free_space", lambda *_: FreeSpace((1 << 19) - 1, 1 << 20))
        monkeypatch.setattr(execution, "require_room", _refuse)
        until_s = monotonic() + 120
        while monotonic() < until_s:
            attempt.progress("tiles", len(seen), 1000)
            seen.append(1)
            sleep(0.01)
        return Outcome()

    job_id = a_job(kept, an_owner(kept), "ingest.work")
    run_all(kept, {"ingest.work": work})
    assert job(kept, job_id).failure_code == "storage_full"


def _refuse(*_: object) -> None:
    raise StorageFullError(FreeSpace(0, 1), 0)
