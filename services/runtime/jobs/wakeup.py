"""Wake-ups: tell a queue's workers that a job is ready. They may fail; the sweeper sends them again.

**Conventions.** Sending happens after the commit, so it must not raise: the job is safe in the database. One wake-up is
as good as another, so whoever took a job without one takes any of that queue back, or somebody would look in vain.
"""

from collections.abc import Callable

import structlog
from kombu.exceptions import OperationalError
from redis import Redis, RedisError

from services.runtime.jobs.broker_app import QUEUES, make_app
from services.runtime.settings import Settings

log = structlog.get_logger(__name__)


def wake_up_sender(settings: Settings) -> Callable[[str, int], None]:
    """The function that sends `times` wake-ups to a queue in the broker of `settings`, or takes some back."""
    app = make_app(settings)
    # kombu would try again after 2 s and after 4 s, while whoever made the commit waits.
    app.conf.broker_transport_options |= {"max_retries": 0}

    def send_wake_ups(queue: str, times: int) -> None:
        if queue not in QUEUES:  # of the sweeper itself, which looks by the clock
            return
        try:
            with app.producer_pool.acquire(block=True) as producer:
                for _ in range(-times):
                    producer.channel.basic_get(queue, no_ack=True)
                for _ in range(times):
                    app.send_task(f"{queue}.work", queue=queue, producer=producer, retry=False, ignore_result=True)
        except (OperationalError, RedisError, OSError) as error:
            log.warning("wake-up not sent; the sweeper will send it again", queue=queue, times=times, reason=str(error))

    return send_wake_ups


def wake_up_counter(settings: Settings) -> Callable[[str], int]:
    """The function that counts wake-ups of a queue not yet received. Raises `redis.RedisError` without a broker."""
    client = Redis.from_url(settings.broker.address, socket_connect_timeout=2, socket_timeout=5)

    def waiting_in(queue: str) -> int:
        return int(client.llen(queue))

    return waiting_in
