"""Why a submission that may be sound is not scored.

**Conventions.** Sentences go to whoever sent the submission in: none says anything about a label.
"""

from stone.errors import Refused


def truth_unready(of: str) -> Refused:
    return Refused(
        "ground_truth_unready",
        f"{of} has no ready ground truth; did the job that builds it not run, or did it fail?",
    )
