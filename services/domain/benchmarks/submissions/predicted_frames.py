"""The predictions of a submission: its zip as uploaded, and single frames.

**Conventions.** Only scored zips are opened: a sandboxed job has read and accepted them completely. Frames are
nevertheless read with the bounded reader (`stone_submissions/archive.py`). A scored zip is kept for re-scores; the zip
of a withdrawn submission is deleted some time later.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from sqlalchemy.orm import Session

from services.domain.benchmarks.submissions.result_errors import UNTIL
from services.domain.benchmarks.submissions.results import ScoreView
from services.runtime.orm import Blob
from stone.errors import Refused
from stone_base.label_grid import grid_with_shape
from stone_submissions.archive import open_submission
from stone_submissions.validation import frame_grid


def downloadable_zip(session: Session, seen: ScoreView) -> Blob:
    """Return the zip if the caller may have its bytes. Raises `withheld`, `predictions_gone`."""
    if not seen.policy.shows("baseline" if seen.submission.kind == "baseline" else "predictions"):
        raise Refused(
            "withheld", f"the zip of this submission cannot be shown: {UNTIL['open']}"
        )  # zips have this policy in all phases
    return _kept_zip(session, seen)


def pictured_zip(session: Session, seen: ScoreView) -> Blob:
    """Return the zip, for pictures of its frames. Raises `frames_hidden`, `predictions_gone`."""
    if not seen.policy.shows("frames"):
        raise Refused(
            "frames_hidden",
            "pictures of frames are shown only in phases with open ground truth; the ground truth of phase "
            f"{seen.phase.name!r} stays hidden",
        )
    return _kept_zip(session, seen)


def predicted_grid(path: Path, tokens: Sequence[str], token: str, shape: tuple[int, ...]) -> NDArray[np.uint8] | None:
    """Return the predicted classes of a frame in this shape, or None if the zip lacks the frame.

    `tokens` are all required frames. Raises `SubmissionError` if the file differs from the accepted one.
    """
    with open_submission(path, tokens, grid_with_shape(shape)) as opened:
        return frame_grid(opened, token) if token in opened.frames else None


def _kept_zip(session: Session, seen: ScoreView) -> Blob:
    if seen.submission.blob_sha256 is None:
        raise Refused(
            "predictions_gone",
            f"the zip of submission {seen.submission.id} was deleted; only its scores are kept",
        )
    return session.get_one(Blob, seen.submission.blob_sha256)
