"""Logs, traces and metrics tell nothing of a hidden phase: no byte of its labels, no digest, no count, no exact score.

**Conventions.** As in `test_leak_crawl.py`, what is hidden is known and is looked for; here in what is told to whoever
watches the platform while the phase's ground truth is built, submissions are scored in it, and its ground truth fails.
"""

import logging
import re
from pathlib import Path

import pytest
from sqlalchemy import select

from services.runtime.orm import Blob, GroundTruthRow, Job
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.telemetry.tracing import close_tracing
from testing.api.serving import client_of
from testing.servers.collector import collecting
from testing.worlds.benchmark_world import new_truth, predicted, run_eval
from testing.worlds.sending import send, zipped
from tests.api.hidden_stage import Stage, staged

PORT = re.compile(rb"(?<=127\.0\.0\.1:)\d+|(?<=port=)\d+")  # as large as counts that are hidden


def spoil_truth(stage: Stage) -> None:
    """The hidden ground truth's pack is cut off in the store, so that scoring meets a fault that quotes what it saw."""
    platform = stage.world.platform
    with platform.database.reading() as session:
        of_phase = select(GroundTruthRow.pack_sha256).where(GroundTruthRow.phase_id == stage.world.test)
        key = session.scalar(select(Blob.object_key).where(Blob.sha256.in_(of_phase)))
    assert key
    path = platform.store.local(key)
    path.write_bytes(path.read_bytes()[:1000])
    frames = predicted(stage.world.truth("test"), 0.3, seed=9)
    send(stage.world, zipped(stage.world, frames), "test")
    run_eval(platform)


def exposition(platform: Platform, stage: Stage) -> bytes:
    with client_of(platform, stage.world.administrator) as api:
        return api.get("/metrics").content


@pytest.mark.whole
def test_what_is_told_while_a_hidden_phase_is_scored_tells_nothing_of_it(
    tmp_path: Path,
    _sqlite_template: Path,  # noqa: PT019  # the file that worlds are copied from
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Catches alone a log line, event or metric that tells of hidden truth while it is used."""
    caplog.set_level(logging.DEBUG)
    begun_ns = now_ns()  # the world may have been made before
    with collecting(monkeypatch) as collector, staged(tmp_path, _sqlite_template) as stage:
        new_truth(stage.world.platform, stage.world.test, stage.world.administrator.user_id)
        spoil_truth(stage)
        exposed = exposition(stage.world.platform, stage)
        close_tracing()
        with stage.world.platform.database.reading() as session:
            ran = select(Job.id).where(Job.queue == "eval", Job.attempt > 0, Job.created_ns > begun_ns)
            job_ids = list(session.scalars(ran))
            spoilt = session.scalars(select(Job).where(Job.state == "failed", Job.queue == "eval")).all()
    out, err = capfd.readouterr()
    lines, spans = PORT.sub(b"", (out + err + caplog.text).encode()), b"\n".join(collector.received)
    told = {"lines": lines, "spans": spans, "metrics": exposed}
    found = {where: stage.secrets.found_in("", text) for where, text in told.items()}
    assert found == {where: [] for where in told}
    assert spoilt, "the fault that was to be told of did not come"
    assert all(job_id.encode() in text for job_id in job_ids for text in (lines, spans))
    assert b'stone_frames_total{work="scored"}' in exposed
    assert stage.secrets.found_in("", lines + next(iter(stage.secrets.texts)).encode())
