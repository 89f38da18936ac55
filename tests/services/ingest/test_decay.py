"""A recording that decayed on the platform is not reported as corrupt."""

from pathlib import Path

import pytest

from services.domain.sequences.recordings import kept_recording
from services.runtime.platform import Platform
from services.runtime.store.faults import noted_faults
from services.runtime.uploads import upload_file
from testing.worlds.decay import decay, flip
from testing.worlds.drives import drive
from testing.worlds.runs import bring, bring_ready, run_all


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return drive(tmp_path_factory)


def test_what_decays_before_it_is_kept_is_asked_for_again_and_not_called_corrupt(platform: Platform, bag: Path) -> None:
    brought = bring(platform)
    job_id = brought.add(bag)
    flip(upload_file(platform.settings, brought.recording().files[0].upload_id or ""), 0.0)
    run_all(platform)
    assert brought.job(job_id).failure_code == "recording_changed"
    assert [one["code"] for one in brought.recording().findings] == ["recording_changed"]


def test_what_decays_in_the_store_is_the_platforms_fault(platform: Platform, bag: Path) -> None:
    brought = bring_ready(platform, bag)
    with platform.database.reading() as session:
        (file,) = kept_recording(session, session.merge(brought.recording(), load=False)).files
    decay(platform, file.object_key)
    run_id = brought.process()
    run_all(platform)
    assert (brought.job(run_id).state, brought.job(run_id).failure_code) == ("failed", "object_damaged")
    with platform.database.reading() as session:
        assert [one.fault for one in noted_faults(session)] == ["bytes"]
