"""Scores of a submission on this machine, with NumPy alone: the platform's ratios, counts, signature and intervals.

**Conventions.** A few threads count frames; each holds one frame. The time order of frames is in tables that only the
platform reads, so intervals of the driven places are left out (`unknown_order`).
"""

from pathlib import Path

import numpy as np

from stone.scoring.frame_counts import LabelRangeError, counted_every, no_column_counts
from stone.scoring.metric import CLASSES
from stone.scoring.numpy_counts import count_by_ring, late_confusion, truth_planes
from stone.scoring.plane_layout import RINGS
from stone.scoring.score_record import ConfidenceLimit, Scores, SubmissionCounts, facts_of
from stone.scoring.signature import Signature
from stone.scoring.truth_hash import truth_hash, whole_hash
from stone_base.label_grid import LabelGrid
from stone_client.progress import Report
from stone_client.release import own_release
from stone_submissions.archive import SubmissionZip, open_submission
from stone_submissions.errors import GroundTruthError, SubmissionError
from stone_submissions.ground_truth import GroundTruth, Mask, find_ground_truth, read_labels
from stone_submissions.validation import THREADS, frame_grid, in_threads, refusal_of
from stone_submissions.verdict import SubmissionRefusedError, ValidationProblem, verdict


def score(
    submission: Path,
    ground_truth: Path,
    *,
    mask: Mask = "all",
    least_confidence: float = 0.0,
    grid: LabelGrid | None = None,
    progress: Report,
) -> Scores:
    """Return the scores of a submission that contains exactly the frames of a folder of labels.

    Raises `SubmissionRefusedError` with the whole validation, `GroundTruthError`, `UnreadableInputError`,
    `no_confidence`, `unknown_grid`.
    """
    truth = find_ground_truth(ground_truth, mask, grid=grid)
    tokens = truth.manifest.tokens
    with open_submission(submission, tokens, truth.manifest.grid) as archive:
        if archive.problems:
            raise SubmissionRefusedError(verdict(archive.problems))
        count = _Count(archive, truth, least_confidence)
        problems = list(in_threads(count.frame, len(tokens), THREADS, progress=progress, stage="score"))
    validation = verdict([problem for problem in problems if problem is not None])
    if not validation.ok:
        raise SubmissionRefusedError(validation)
    limit = ConfidenceLimit(least_confidence, sum(count.left_out.values())) if least_confidence > 0 else None
    evaluated = mask if limit is None else f"{mask},confidence>={least_confidence:g}"
    signature = Signature(whole_hash(count.hashes), evaluated, grid=truth.manifest.grid)
    return Scores(count.counts, signature, False, f"stone-client {own_release()}", limit)


class _Count:
    """The counts of all frames of a submission, filled frame by frame."""

    def __init__(self, archive: SubmissionZip, truth: GroundTruth, least_confidence: float) -> None:
        self._archive, self._truth, self._least_confidence = archive, truth, least_confidence
        self._tokens, self._paths = truth.manifest.tokens, truth.paths()
        frames = len(self._tokens)
        self._every = counted_every(frames)
        self.hashes, self.left_out = dict[str, bytes](), dict[str, int]()
        self.column_counts = no_column_counts((frames,))
        self.late = np.zeros((frames, CLASSES, CLASSES), np.int32)
        self.counts = SubmissionCounts(
            np.zeros((frames, RINGS, CLASSES, CLASSES), np.int32),
            np.zeros((frames, RINGS, 3), np.int32),
            facts_of(truth.manifest.sequences),
            self.column_counts,
            self.late,
        )

    def frame(self, index: int) -> ValidationProblem | None:
        """Count one frame; return the problem of its prediction, or None. Raises `GroundTruthError`."""
        token, grid = self._tokens[index], self._truth.manifest.grid
        path = self._paths[token]
        labels = read_labels(path, self._truth.mask, grid, self._least_confidence)
        try:
            planes = truth_planes(labels.semantics, labels.is_evaluated, grid, labels.is_late)
        except LabelRangeError as error:
            raise GroundTruthError(path, str(error)) from error
        self.hashes[token], self.left_out[token] = truth_hash(planes), labels.left_out
        is_sampled = index % self._every == 0

        def count() -> None:
            prediction = frame_grid(self._archive, token)
            try:
                outs = self.counts.confusions[index], self.counts.bev[index]
                count_by_ring(prediction, planes, *outs, self.column_counts.of_frame(index) if is_sampled else None)
                if is_sampled:
                    self.late[index] = late_confusion(prediction, planes)
            except LabelRangeError as error:
                raise SubmissionError("label_out_of_range", "labels 0 to 3", str(error.value)) from error

        return refusal_of(self._archive, token, count)
