"""An attempt at the late checks that is killed once, for the tests of what it leaves."""

from services.domain.sequences.processing import CHECK
from services.runtime.jobs.specs import Attempt, Handler, Outcome


def killed_once(kind: str, handler: Handler) -> Handler:
    """The first attempt at the checks has done everything and written nothing when it ends."""

    def run(attempt: Attempt) -> Outcome:
        outcome = handler(attempt)
        if kind == CHECK and attempt.job_id not in killed:
            killed.add(attempt.job_id)
            raise RuntimeError("killed")
        return outcome

    killed: set[str] = set()
    return run
