"""Wake-ups notify a queue's workers that a job is ready. They may fail; the sweeper sends them again.

**Conventions.** Sending happens after the commit, so it must not raise: the job is safe in the database. Wake-ups are
interchangeable, so a worker that took a job without a wake-up takes any wake-up of that queue back; otherwise a worker
would search in vain. A caller waits at most `DEADLINE_S`. After a failure no caller tries again for the same time, so
that calls do not queue up.
"""

import time
from collections.abc import Callable

import structlog
from kombu.exceptions import LimitExceeded, OperationalError
from redis import Redis, RedisError

from services.runtime.jobs.broker_app import QUEUES, make_app
from services.runtime.settings import Settings

DEADLINE_S = 2.0

log = structlog.get_logger(__name__)


def wake_up_sender(settings: Settings) -> Callable[[str, int], None]:
    """Return the function that sends `times` wake-ups to a queue in the broker of `settings`, or takes some back."""
    app = make_app(settings)
    # kombu would try again after 2 s and after 4 s, while the committing caller waits.
    app.conf.broker_transport_options |= {"max_retries": 0, "socket_timeout": DEADLINE_S}
    resting_until_s = 0.0

    def send_wake_ups(queue: str, times: int) -> None:
        nonlocal resting_until_s
        if queue not in QUEUES:  # a queue of the sweeper itself, which polls
            return
        try:
            with app.producer_pool.acquire(block=True, timeout=DEADLINE_S) as producer:
                if time.monotonic() < resting_until_s:
                    return
                for _ in range(-times):
                    producer.channel.basic_get(queue, no_ack=True)
                for _ in range(times):
                    app.send_task(f"{queue}.work", queue=queue, producer=producer, retry=False, ignore_result=True)
        except (OperationalError, RedisError, OSError, LimitExceeded) as error:
            resting_until_s = time.monotonic() + DEADLINE_S
            log.warning("wake-up not sent; the sweeper sends it again", queue=queue, times=times, reason=str(error))

    return send_wake_ups


def wake_up_counter(settings: Settings) -> Callable[[str], int]:
    """Return the function that counts wake-ups not yet received. Raises `redis.RedisError` without a broker."""
    client = Redis.from_url(settings.broker.address, socket_connect_timeout=2, socket_timeout=5)

    def waiting_in(queue: str) -> int:
        return int(client.llen(queue))

    return waiting_in
