"""Why a submission that may be sound is not scored, or a ground truth not built: one leaf a code.

**Conventions.** Sentences go to whoever sent the submission in: none says anything about a label.
"""

from stone.errors import PlatformFaultError, StoneError


class UploadDamagedError(StoneError):
    """The file that was sent in is not, or not any more, the one that was declared."""

    code = "upload_damaged"

    def __init__(self, found: str, declared: str) -> None:
        what = f"a file of sha256 {found}" if found else "no file"
        super().__init__(
            f"{what} stands where {declared} was declared; was it changed after it was sent? Send it again"
        )


class PurgedError(StoneError):
    """The file of a submission is not kept any more, so it cannot be scored again."""

    code = "submission_purged"

    def __init__(self, submission_id: str) -> None:
        super().__init__(f"the file of submission {submission_id} was purged and cannot be counted again; send it anew")


class TruthUnreadyError(StoneError):
    """There is nothing to score against yet."""

    code = "ground_truth_unready"

    def __init__(self, of: str) -> None:
        super().__init__(f"{of} has no ground truth that is ready; was the job that builds it not run, or did it fail?")


class LabelsUnfitError(StoneError):
    """The labels of a dataset version are no ground truth; only what is public of them is said."""

    code = "labels_unfit"

    def __init__(self, where: str, fault: str) -> None:
        super().__init__(f"{where} of the dataset version: {fault}; was it labelled by this program?")


class TruthDamagedError(PlatformFaultError):
    """The kept ground truth cannot be read: no fault of what is held against it."""

    def __init__(self) -> None:
        super().__init__(
            "ground_truth_damaged",
            "the ground truth that is kept cannot be read; was the store changed by hand, or is it away?",
        )
