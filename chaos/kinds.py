"""The kinds of kills: each plays one round and returns the owner's run.

**Conventions.** A kind draws its moment and its victim from the round's random numbers. Right before the kill it notes
whether work is running there; then it waits for the owner's result. A kill that hits no work is reported.
"""

from collections.abc import Callable
from dataclasses import dataclass

from chaos.load import under_load
from chaos.process_kills import kill_redis, kill_sweeper, kill_worker, restart_postgres, restart_s3
from chaos.result_hashes import OwnerRun
from chaos.turns import OwnerRound, await_end
from chaos.upload_kills import kill_api, kill_client

Kill = Callable[[OwnerRound, str], None]


@dataclass(frozen=True)
class Kind:
    """`name` is the word for the command line, `title` for the table; `play` plays one round."""

    name: str
    title: str
    play: Callable[[OwnerRound], OwnerRun]
    on_postgres: bool = False
    on_s3: bool = False
    uploads_in_store: bool = False


def undisturbed(turn: OwnerRound) -> OwnerRun:
    """Play a round without a kill."""
    return _during_run(turn, lambda turn, run_id: None)


def _during_run(turn: OwnerRound, strike: Kill) -> OwnerRun:
    """Upload the recording, start the run, strike at a random moment, wait for the end."""
    with turn.connected() as api:
        sequence = turn.announce(api)
        turn.send(api, sequence)
        brought = turn.process(api, sequence)
        strike(turn, brought.run_id)
        await_end(api, brought.run_id)
        return brought


def _under_load(turn: OwnerRound) -> OwnerRun:
    with under_load(turn):
        return _during_run(turn, restart_postgres)


KINDS = (
    Kind("worker", "kill −9 a worker", lambda turn: _during_run(turn, kill_worker)),
    Kind("api", "kill −9 the API mid-PATCH", kill_api),
    Kind(
        "parts",
        "kill −9 the API mid-PATCH, uploads in the S3 store",
        kill_api,
        on_postgres=True,
        on_s3=True,
        uploads_in_store=True,
    ),
    Kind("client", "kill −9 the client mid-upload", kill_client),
    Kind("redis", "kill −9 Redis with wake-ups queued", lambda turn: _during_run(turn, kill_redis)),
    Kind("sweeper", "kill −9 the sweeper, with lost work to resume", lambda turn: _during_run(turn, kill_sweeper)),
    Kind("postgres", "restart PostgreSQL under load", _under_load, on_postgres=True),
    Kind("s3", "kill −9 the S3 store", lambda turn: _during_run(turn, restart_s3), on_postgres=True, on_s3=True),
)
