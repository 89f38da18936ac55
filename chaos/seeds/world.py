"""The world of one history: platform, broker, processes and the record of the owner's requests."""

import random
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

from chaos.seeds.faulty_database import FaultyDatabase
from chaos.seeds.scheduler import Process, Scheduler, VirtualEvent
from services.runtime.platform import Platform
from services.runtime.settings import JobSettings, Settings
from services.runtime.store.protocol import Store

QUEUES = ("ingest", "labeler")
LIMITS = JobSettings(time_limit_s=150.0)


class Broker:
    """A broker that loses, doubles or delays some wake-ups; a worker that receives a message removes it."""

    def __init__(self, scheduler: Scheduler) -> None:
        self._scheduler, self._dice = scheduler, scheduler.dice
        self._held = {queue: deque[None]() for queue in QUEUES}
        self._process = Process("broker")
        self.rung = VirtualEvent(scheduler)
        self.share = 0.0
        self.away_until_s = 0.0

    @property
    def is_away(self) -> bool:
        return self._scheduler.now_s < self.away_until_s

    def send(self, queue: str, times: int) -> None:
        """Send wake-ups, or take some back; does nothing while the broker is away."""
        if self.is_away:
            return
        for _ in range(min(-times, len(self._held[queue]))):
            self._held[queue].pop()
        for _ in range(times):
            drawn = self._dice.random()
            if drawn < self.share * 0.4:
                continue
            if drawn < self.share * 0.7:
                self._scheduler.spawn(self._process, "late", lambda: self._send_late(queue))
                continue
            self._arrive(queue, 2 if drawn < self.share else 1)

    def waiting(self, queue: str) -> int:
        """Return the number of wake-ups in a queue. Raises `ConnectionError` while the broker is away."""
        if self.is_away:
            raise ConnectionError("the broker is away")
        return len(self._held.get(queue, ()))

    def receive(self) -> str:
        """Wait for the next wake-up and return its queue."""
        while True:
            ready = [queue for queue in QUEUES if self._held[queue]]
            if ready and not self.is_away:
                queue = self._dice.choice(ready)
                self._held[queue].pop()
                return queue
            self.rung.clear()
            self.rung.wait(60.0)

    def forget(self) -> None:
        """Delete all wake-ups, as a restart does."""
        for held in self._held.values():
            held.clear()

    def _send_late(self, queue: str) -> None:
        self._scheduler.pause(self._dice.choice((0.1, 3.0, 40.0)))
        self._arrive(queue, 1)

    def _arrive(self, queue: str, times: int) -> None:
        self._held[queue].extend([None] * times)
        self.rung.set()


@dataclass
class RunRequests:
    """The owner's requests for a run: whether its stop was acknowledged, and how many retries may have happened."""

    stopped: bool = False
    retries: int = 0


@dataclass
class World:
    """`wanted` is the target number of workers; `calm()` ends all faults."""

    seed: int
    dice: random.Random = field(init=False)
    runs: list[str] = field(default_factory=list)
    requests: dict[str, RunRequests] = field(default_factory=dict)
    workers: list[Process] = field(default_factory=list)
    wanted: int = 0
    is_calm: bool = False

    def __post_init__(self) -> None:
        self.dice = random.Random(self.seed)
        self.scheduler = Scheduler(self.dice)
        self.broker = Broker(self.scheduler)
        settings = Settings(data_folder=Path("/nonexistent"), jobs=LIMITS)
        self.database = FaultyDatabase(settings, self.scheduler, self.broker.send)
        self.platform = Platform(settings, self.database, cast("Store", None))  # jobs use no store
        self.database.share = self.dice.choice((0.0, 0.02, 0.05, 0.15))
        self.broker.share = self.dice.choice((0.0, 0.1, 0.5))

    def calm(self) -> None:
        self.is_calm = True
        self.database.share = self.broker.share = 0.0
        self.database.away_until_s = self.broker.away_until_s = 0.0
        for process in self.workers:
            process.held_until_s = min(process.held_until_s, self.scheduler.now_s + 1.0)

    def requests_of(self, run_id: str) -> RunRequests:
        return self.requests.setdefault(run_id, RunRequests())
