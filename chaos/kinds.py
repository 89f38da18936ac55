"""The five ways to kill: each plays one round and answers with what was brought.

**Conventions.** A kind draws its moment and its victim by the round's chance, notes right before the kill whether work
is under way there, and waits until the owner has what they came for. A kill that hits nothing is told, not hidden.
"""

from collections.abc import Callable
from dataclasses import dataclass

from chaos.load import under_load
from chaos.made import Brought
from chaos.sending import kill_api, kill_client
from chaos.striking import kill_redis, kill_worker, restart_postgres
from chaos.turns import Turn, await_end

Strike = Callable[[Turn, str], None]


@dataclass(frozen=True)
class Kind:
    """`name` is said on the command line, `title` in the table; `play` is one round."""

    name: str
    title: str
    play: Callable[[Turn], Brought]
    on_postgres: bool = False


def undisturbed(turn: Turn) -> Brought:
    """The same without a kill."""
    return _during_run(turn, lambda turn, run_id: None)


def _during_run(turn: Turn, strike: Strike) -> Brought:
    """Bring the recording, start the run, strike at some moment, wait for the end."""
    with turn.connected() as api:
        sequence = turn.announce(api)
        turn.send(api, sequence)
        brought = turn.process(api, sequence)
        strike(turn, brought.run_id)
        await_end(api, brought.run_id)
        return brought


def _under_load(turn: Turn) -> Brought:
    with under_load(turn):
        return _during_run(turn, restart_postgres)


KINDS = (
    Kind("worker", "kill −9 a worker", lambda turn: _during_run(turn, kill_worker)),
    Kind("api", "kill −9 the API mid-PATCH", kill_api),
    Kind("client", "kill −9 the client mid-upload", kill_client),
    Kind("redis", "kill −9 Redis with bells queued", lambda turn: _during_run(turn, kill_redis)),
    Kind("postgres", "restart PostgreSQL under load", _under_load, on_postgres=True),
)
