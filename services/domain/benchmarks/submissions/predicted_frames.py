"""The predictions that a submission holds: its zip as it was kept, and single frames of it.

**Conventions.** Only zips that were scored are opened, which a sandboxed job has read whole and accepted; they are read
by the same bounded reader (`stone_submissions/archive.py`) nevertheless. A scored zip is kept for re-scores; that of a
withdrawn submission is purged some time later.
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
        )  # its sentence is true of zips whatever the phase hides
    return _kept_zip(session, seen)


def pictured_zip(session: Session, seen: ScoreView) -> Blob:
    """The zip, to make pictures of its frames. Raises `frames_hidden`, `predictions_gone`."""
    if not seen.policy.shows("frames"):
        raise Refused(
            "frames_hidden",
            "pictures of frames are shown only in phases with open ground truth; the ground truth of phase "
            f"{seen.phase.name!r} stays hidden",
        )
    return _kept_zip(session, seen)


def predicted_grid(path: Path, tokens: Sequence[str], token: str, shape: tuple[int, ...]) -> NDArray[np.uint8] | None:
    """The classes, of this shape, that the zip predicts for a frame, of all `tokens` it must hold; None without it.

    Raises `SubmissionError` where the file is not what was accepted.
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
