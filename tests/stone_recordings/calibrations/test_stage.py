"""A run in the queue says when its calibration was not valid, and keeps a picture of every camera."""

import pytest
from sqlalchemy import select

from services.runtime.orm import CalibrationRow, Preview
from services.runtime.platform import Platform
from simulator.pipeline import calibration_path
from testing.worlds.runs import bring, run_all
from tests.stone_recordings.calibrations.conftest import Drive


@pytest.mark.whole
def test_a_run_doubts_a_calibration_out_of_its_time_and_keeps_the_overlays(platform: Platform, drive: Drive) -> None:
    """Catches alone a doubt that is not told, or pictures that are not kept, at the end of a run."""
    brought = bring(platform)
    brought.calibrate(calibration_path(drive.path))
    with platform.database.transaction() as session:
        session.scalars(select(CalibrationRow)).one().valid_to_ns = int(drive.sequence.frames.stamps_ns[0])
    brought.add(drive.path)
    run_all(platform)
    root_id = brought.process(stages=("synchronise",))
    run_all(platform)
    job, check = (job for job in brought.jobs(root_id) if job.queue)
    assert job.state == check.state == "succeeded", (job.failure, check.failure)
    assert "CAL-418" in {finding["code"] for finding in job.result["findings"]}
    with platform.database.reading() as session:
        kept = {preview.name: preview.media_type for preview in session.scalars(select(Preview))}
    for mount in drive.sequence.calibration.of_kind("camera"):
        assert kept[f"overlay_{mount.name}.jpg"] == "image/jpeg"
