"""Connections from one address that start a request and then stop, beside the clients of `benchmarks.load`.

**Conventions.** `python -m benchmarks.load.strangers PLAN.json OUT.json`. A third of the connections is silent, a third
stops in a head, and a third stops one byte before the end of a sign-in's body of 2 MiB. `PAUSE_S` after a connection
ends, it is opened again.
"""

import asyncio
import json
import sys
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from services.runtime.telemetry.descriptors import raise_descriptor_limit

BODY_BYTES = 2 * 2**20
PAUSE_S = 5.0
HALF_HEAD = b"POST /api/v1/sessions HTTP/1.1\r\nHost: api\r\n"
HALF_BODY = (
    HALF_HEAD
    + f"Content-Type: application/json\r\nContent-Length: {BODY_BYTES}\r\n\r\n".encode()
    + b" " * (BODY_BYTES - 1)
)
SENT = (b"", HALF_HEAD, HALF_BODY)


@dataclass(frozen=True)
class StrangersPlan:
    """`count` connections from `source`, which start after `wait_s` and last `seconds`."""

    port: int
    count: int
    wait_s: float
    seconds: float
    source: str = "127.0.0.1"


class Strangers:
    """The connections and counts of their ends (`seen`); `begun_s` is on the machine's monotonic clock."""

    def __init__(self, plan: StrangersPlan) -> None:
        self.plan, self.seen, self.open, self.most_open = plan, Counter[str](), 0, 0
        self.begun_s = 0.0

    async def run(self) -> None:
        await asyncio.sleep(self.plan.wait_s)
        self.begun_s = time.perf_counter()
        held = [asyncio.create_task(self._hold(SENT[number % len(SENT)])) for number in range(self.plan.count)]
        await asyncio.sleep(self.plan.seconds)
        for task in held:
            task.cancel()
        await asyncio.gather(*held, return_exceptions=True)

    async def _hold(self, sent: bytes) -> None:
        while True:
            try:
                await self._connection(sent)
            except OSError as error:
                self.seen[type(error).__name__] += 1
            await asyncio.sleep(PAUSE_S)

    async def _connection(self, sent: bytes) -> None:
        incoming, outgoing = await asyncio.open_connection(
            "127.0.0.1", self.plan.port, local_addr=(self.plan.source, 0)
        )
        self.open += 1
        self.most_open = max(self.open, self.most_open)
        try:
            outgoing.write(sent)
            answer = await incoming.read(12)
            self.seen[answer.decode("latin-1") or "closed"] += 1
            await incoming.read()
        finally:
            self.open -= 1
            outgoing.transport.abort()


def main() -> None:
    plan_path, out_path = map(Path, sys.argv[1:])
    raise_descriptor_limit()
    strangers = Strangers(StrangersPlan(**json.loads(plan_path.read_text())))
    asyncio.run(strangers.run())
    noted = {"begun_s": strangers.begun_s, "seen": strangers.seen, "most_open": strangers.most_open}
    out_path.write_text(json.dumps(noted))


if __name__ == "__main__":
    main()
