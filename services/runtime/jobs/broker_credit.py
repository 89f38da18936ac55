"""A worker's room for a further wake-up is free again whether or not the broker heard that one was taken.

**Conventions.** A worker has room for as many wake-ups as it has processes, and does not listen to the broker while it
has none left. kombu 5.7 frees the room of a message once Redis has answered to its acknowledgement. If Redis ends in
that moment, the room is never free again; the worker, not listening, does not learn that the connection is gone
either, and takes no job any more. A wake-up that is delivered twice finds nothing to do, so nothing is lost by freeing
its room in any case.
"""

from kombu.transport import redis, virtual


class WakeUpQoS(redis.QoS):
    """What a channel holds that was delivered and not acknowledged yet."""

    def ack(self, delivery_tag: str) -> None:
        """Raises what the connection raises."""
        try:
            super().ack(delivery_tag)  # type: ignore[no-untyped-call]
        finally:
            virtual.QoS.ack(self, delivery_tag)  # type: ignore[no-untyped-call]


def free_room_in_any_case() -> None:
    """Have channels of this process hold wake-ups so."""
    redis.Channel.QoS = WakeUpQoS
