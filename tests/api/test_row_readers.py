"""A few threads answer what is only read, whoever came first first, and hold up nothing else."""

import asyncio
from threading import Event, Lock

from anyio.from_thread import start_blocking_portal
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from api.row_readers import by_row_readers
from services.runtime.database.connections import ROW_READERS

WITHIN_S = 20.0


class Readings:
    """What is at work, the most that ever was, and who began in which order."""

    def __init__(self) -> None:
        self.at_work = self.most = 0
        self.begun, self.lock, self.go_on = list[int](), Lock(), Event()

    def read(self, number: int) -> Response:
        with self.lock:
            self.begun.append(number)
            self.at_work += 1
            self.most = max(self.most, self.at_work)
        assert self.go_on.wait(WITHIN_S)
        with self.lock:
            self.at_work -= 1
        return Response(str(number))


async def while_reading(readings: Readings, requests: int) -> list[bytes]:
    read = by_row_readers(readings.read)
    asked = [asyncio.create_task(read(number)) for number in range(requests)]
    while len(readings.begun) < ROW_READERS:
        await asyncio.sleep(0.001)
    await asyncio.wait_for(run_in_threadpool(lambda: None), WITHIN_S)  # as other routes are answered
    assert readings.at_work == ROW_READERS
    readings.go_on.set()
    return [bytes(answer.body) for answer in await asyncio.gather(*asked)]


def test_a_few_at_a_time_read_in_the_order_in_which_they_came_beside_everything_else() -> None:
    for _ in range(2):  # event loops, which share no threads
        readings = Readings()
        with start_blocking_portal() as portal:  # a loop of its own: a browser's may run in this thread
            answers = portal.call(while_reading, readings, 40)
        assert answers == [b"%d" % number for number in range(40)]
        assert readings.most == ROW_READERS
        assert sorted(readings.begun[:ROW_READERS]) == list(range(ROW_READERS))


def test_what_is_refused_while_it_is_read_is_refused() -> None:
    def refuse() -> Response:
        raise KeyError("gone")

    async def asked() -> list[BaseException | Response]:
        return await asyncio.gather(*(by_row_readers(refuse)() for _ in range(2 * ROW_READERS)), return_exceptions=True)

    with start_blocking_portal() as portal:
        assert [type(one) for one in portal.call(asked)] == [KeyError] * 2 * ROW_READERS
