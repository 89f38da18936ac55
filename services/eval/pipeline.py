"""From a submitted zip to a verdict, and from a valid one to scores. Start reading here.

    open → part (each range of frames) → join → score

The archive's directory is checked when it is opened. A range (`services/domain/benchmarks/submissions/scoring_jobs.py`)
is `examined`, counted or only checked, and all ranges are `joined` (both `services/eval/examination.py`). This module
examines one range after another on a few threads; the queue examines each range in a sandbox, in its own job if there
are several (`services/eval/queue_handlers.py`).

**Conventions.** This module starts no process and keeps no state, so it can run in a child with memory and time limits.
Peak memory does not grow with the submission, except for the counts: 468 bytes per frame, twice as much during the
join.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from services.domain.benchmarks.submissions.scoring_ranges import ranges_of
from services.eval.examination import Counts, ExaminedRange, TruthOf, examined, joined, sampled_tokens
from services.eval.ground_truth import planes_of_labels
from services.runtime.code_version import code_version
from stone.scoring.frame_counts import TruthPlanes
from stone.scoring.score_record import ConfidenceLimit, Scores, SubmissionCounts, facts_of
from stone.scoring.signature import Signature
from stone.scoring.truth_hash import truth_hash, whole_hash
from stone_base.label_grid import LabelGrid
from stone_submissions.archive import SubmissionZip, open_submission
from stone_submissions.ground_truth import FrameOrder, Mask, find_ground_truth, read_labels
from stone_submissions.validation import THREADS, Progress, silent
from stone_submissions.verdict import SubmissionRefusedError, verdict


def score(
    zip_path: Path,
    ground_truth_dir: Path,
    *,
    mask: Mask = "all",
    least_confidence: float = 0.0,
    threads: int = THREADS,
    progress: Progress = silent,
    order: FrameOrder | None = None,
    grid: LabelGrid | None = None,
) -> Scores:
    """Return the scores of a submission that contains exactly the frames of this ground truth.

    Without the frames' `order` in time there are no intervals for these places. Occupied voxels whose label is right
    with a probability below `least_confidence` are left out.

    Raises `SubmissionRefusedError` with the whole validation, `GroundTruthError`, `UnreadableInputError`,
    `no_confidence`, `unknown_grid`, and what `order` raises.
    """
    truth = find_ground_truth(ground_truth_dir, mask, order, grid)
    label_grid = truth.manifest.grid
    paths, hashes, left_out = truth.paths(), dict[str, bytes](), dict[str, int]()

    def truth_of(token: str) -> TruthPlanes:
        labels = read_labels(paths[token], mask, label_grid, least_confidence)
        planes, left_out[token] = planes_of_labels(labels, paths[token], label_grid), labels.left_out
        hashes[token] = truth_hash(planes)
        return planes

    with open_submission(zip_path, truth.manifest.tokens, label_grid) as submission:
        counted = count(submission, truth.manifest.tokens, truth_of, threads=threads, progress=progress)
    counts_of_frames = SubmissionCounts(
        counted.confusions,
        counted.bev,
        facts_of(truth.manifest.sequences, truth.timed),
        counted.column_counts,
        counted.late,
    )
    limit = ConfidenceLimit(least_confidence, sum(left_out.values())) if least_confidence > 0 else None
    evaluated = truth.mask if limit is None else f"{truth.mask},confidence>={least_confidence:g}"
    signature = Signature(whole_hash(hashes), evaluated, grid=label_grid)
    return Scores(counts_of_frames, signature, truth.timed is not None, code_version("scores"), limit)


def count(
    submission: SubmissionZip,
    tokens: Sequence[str],
    truth_of: TruthOf,
    *,
    threads: int = THREADS,
    progress: Progress = silent,
) -> Counts:
    """Return the counts of these frames of a valid submission.

    Raises `SubmissionRefusedError`; an archive with wrong names is refused before any frame is counted.
    """
    if submission.problems:
        raise SubmissionRefusedError(verdict(submission.problems))
    examination = _examine_ranges(submission, tokens, truth_of, _Onward(threads, progress, len(tokens)))
    if examination.counts is None:
        raise SubmissionRefusedError(examination.validation)
    return examination.counts


@dataclass
class _Onward:
    """The progress over all frames; `before` counts the frames of finished ranges."""

    threads: int
    progress: Progress
    total: int
    before: int = 0

    def __call__(self, stage: str, done: int, total: int) -> None:
        self.progress(stage, self.before + done, self.total)
        self.before += total if done == total else 0


def _examine_ranges(
    submission: SubmissionZip, tokens: Sequence[str], truth_of: TruthOf | None, onward: _Onward
) -> ExaminedRange:
    """Examine all ranges of these frames, one after another, and join them."""
    ranges, wanted = (tokens[slice(*span)] for span in ranges_of(len(tokens))), sampled_tokens(tokens)
    return joined(
        examined(submission, range_, truth_of, sampled=wanted, threads=onward.threads, progress=onward)
        for range_ in ranges
    )
