"""Errors for which a possibly valid submission is not scored.

**Conventions.** The submitter reads these sentences: they must reveal nothing about a label.
"""

from stone.errors import Refused


def truth_unready(of: str) -> Refused:
    return Refused(
        "ground_truth_unready",
        f"{of} has no ready ground truth; did the job that builds it not run, or did it fail?",
    )
