"""Ringing: tells the workers of a queue that a job is ready. May fail; the sweeper rings again.

**Conventions.** Ringing happens after the commit, so it must not raise: the job is safe in the database.
"""

from collections.abc import Callable

import structlog
from kombu.exceptions import OperationalError
from redis import Redis

from services.runtime.celery_app import make_app
from services.runtime.settings import Settings

log = structlog.get_logger(__name__)


def ring(settings: Settings) -> Callable[[str, int], None]:
    """The function that rings `times` for a queue in the broker of `settings`."""
    app = make_app(settings)

    def ring_queue(queue: str, times: int) -> None:
        try:
            with app.producer_pool.acquire(block=True) as producer:
                for _ in range(times):
                    app.send_task(f"{queue}.work", queue=queue, producer=producer, retry=False, ignore_result=True)
        except (OperationalError, OSError) as error:
            log.warning("bell not heard; the sweeper will ring again", queue=queue, times=times, reason=str(error))

    return ring_queue


def waiting(settings: Settings) -> Callable[[str], int]:
    """The function that tells how many bells lie unheard in a queue. Raises `redis.RedisError` without a broker."""
    client = Redis.from_url(settings.broker.address, socket_connect_timeout=2, socket_timeout=5)

    def waiting_in(queue: str) -> int:
        return int(client.llen(queue))

    return waiting_in
