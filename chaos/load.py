"""Background load for the kill suite: readers of lists, and a writer whose writes must not be lost.

**Conventions.** They use the client, which repeats requests if that is safe. An error without an outage (a server
fault, a refusal) is a violation. A write is acknowledged when its answer arrives, or when the server reports later that
it took effect.
"""

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from threading import Event, Thread

from sqlalchemy import select

from chaos.places import RoundOwner
from chaos.turns import PATIENCE_S, OwnerRound
from chaos.verdict import Sort, Violation
from services.runtime.orm import SequenceRow
from stone.errors import StoneError
from stone_client.api import Api
from stone_client.errors import ServerRefusedError

READERS = 2
PAUSE_S = 0.05
REPLY_NOT_KEPT = "reply_not_kept"


@dataclass
class _Load:
    """Shared state of the load: its owner, acknowledged writes and violations."""

    owner: RoundOwner
    over: Event = field(default_factory=Event)
    acknowledged: list[str] = field(default_factory=list)
    violations: list[Violation] = field(default_factory=list)

    def read(self, api: Api) -> None:
        api.read("/sequences")
        api.read("/jobs")

    def write(self, api: Api) -> None:
        name = f"load-{len(self.acknowledged)}"
        try:
            api.create("/sequences", {"name": name})
        except ServerRefusedError as error:
            if error.code != REPLY_NOT_KEPT:
                raise
        self.acknowledged.append(name)

    def repeat(self, act: Callable[[Api], None]) -> None:
        """Repeat an act until the load ends or an error occurs."""
        with Api(self.owner.server, patience_s=PATIENCE_S) as api:
            try:
                while not self.over.wait(PAUSE_S):
                    act(api)
            except StoneError as error:
                self.violations.append(Violation("lost", f"{act.__name__} under load: {type(error).__name__}: {error}"))


@contextmanager
def under_load(turn: OwnerRound) -> Iterator[None]:
    """Run the load during the block; afterwards check that every acknowledged write exists."""
    load = _Load(turn.target.welcome(f"load-{turn.owner.user_id}"))
    acts = [load.read] * READERS + [load.write]
    threads = [Thread(target=load.repeat, args=(act,), name=f"load {act.__name__}") for act in acts]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        load.over.set()
        for thread in threads:
            thread.join()
    turn.violations.extend([*load.violations, *_judge(turn, load)])


def _judge(turn: OwnerRound, load: _Load) -> Iterator[Violation]:
    """Yield a violation unless each acknowledged sequence exists exactly once."""
    with turn.target.platform.database.reading() as session:
        names = Counter(session.scalars(select(SequenceRow.name).where(SequenceRow.owner_id == load.owner.user_id)))
    for name in load.acknowledged:
        if names[name] != 1:
            sort: Sort = "doubled" if names[name] else "lost"
            yield Violation(sort, f"sequence {name} was acknowledged and exists {names[name]} times")
    if not load.acknowledged:
        yield Violation("lost", "there were no writes, so there was no load")
