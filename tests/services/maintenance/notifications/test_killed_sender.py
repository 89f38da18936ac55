"""The sweeper killed by -9 at any moment of its sending: each event is received at least once, with its own id."""

import json
import os
import random
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

from services.runtime.embedded.programs import environment_of
from services.runtime.platform import Platform
from services.runtime.settings import JobSettings
from testing.servers.webhook_receiver import webhook_receiver
from tests.services.maintenance.notifications.steps import a_user, deliveries, happened, telling

QUICK = JobSettings(lease_s=0.6, heartbeat_s=0.1, progress_s=0.1, sweep_s=0.02, rest_s=0.1)
EVENTS, KILLS, PATIENCE_S = 40, 12, 300.0


def test_killed_at_many_moments_the_sender_loses_nothing_and_repeats_only_with_the_same_id(
    platform: Platform, tmp_path: Path
) -> None:
    """A sweeper process started and killed a dozen times (35 CPU-seconds): nothing else runs the sender as it ships,
    and only so a message is sent whose end is never written."""
    settings = platform.settings.model_copy(update={"jobs": QUICK})
    platform = telling(replace(platform, settings=settings), retry_s=0.01)
    chance = random.Random(20)
    with webhook_receiver(tmp_path) as receiver:
        user_id = a_user(platform, "ada", receiver.url())
        for number in range(EVENTS):
            happened(platform, user_id, number=number)
        kills, deadline_s = 0, time.monotonic() + PATIENCE_S
        while not all_delivered(platform):
            assert time.monotonic() < deadline_s, [(row.state, row.answer) for row in deliveries(platform)]
            before = len(receiver.received())
            process = started(platform, tmp_path)
            if kills < KILLS:
                wait_for_more(receiver, before + chance.randrange(1, 4), process, deadline_s)
                time.sleep(chance.random() * 0.02)  # any moment after an answer: before, while, after it is written
                process.kill()
                kills += 1
            else:
                while not all_delivered(platform) and time.monotonic() < deadline_s:
                    time.sleep(0.05)
                process.kill()
            process.wait()
        came = receiver.received()
    ids = [one["headers"]["webhook-id"] for one in came]
    once = {one["headers"]["webhook-id"]: json.loads(one["body"])["data"]["number"] for one in came}
    assert sorted(once.values()) == list(range(EVENTS))  # whoever drops repeated ids holds each exactly once
    assert set(ids) == {f"msg_{row.id}" for row in deliveries(platform)}
    for one in came:
        assert once[one["headers"]["webhook-id"]] == json.loads(one["body"])["data"]["number"]


def started(platform: Platform, folder: Path) -> "subprocess.Popen[bytes]":
    command = [sys.executable, "-P", "-m", "services.maintenance.sweeper"]
    environment = {**environment_of(platform.settings), "PYTHONPATH": os.getcwd()}
    with (folder / "sweeper.log").open("ab") as log:
        return subprocess.Popen(command, env=environment, stdout=log, stderr=log)


def all_delivered(platform: Platform) -> bool:
    rows = deliveries(platform)
    return len(rows) == EVENTS and all(row.state == "delivered" for row in rows)


def wait_for_more(receiver: object, wanted: int, process: "subprocess.Popen[bytes]", deadline_s: float) -> None:
    while len(receiver.received()) < min(wanted, EVENTS) and process.poll() is None:  # type: ignore[attr-defined]
        assert time.monotonic() < deadline_s
        time.sleep(0.005)
