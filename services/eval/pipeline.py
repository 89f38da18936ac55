"""From a submitted zip to a verdict, and from a valid one to scores. Read this first.

**Conventions.** Nothing here starts a process or keeps state, so it runs as it is in a child with memory and time
limits. Peak memory does not grow with the submission, but for 192 bytes a frame.
"""

from collections.abc import Sequence
from pathlib import Path

from services.eval.counting import THREADS, Counted, Progress, TruthOf, check_range, count_range, silent
from services.eval.ground_truth import Mask, find_ground_truth, read_truth, truth_hash, whole_hash
from services.eval.manifest import read_manifest
from services.eval.scores import Scores, SequenceFacts, Tally
from services.eval.submission_zip import Submission, open_submission
from services.eval.validation import SubmissionRefusedError, Validation, verdict
from stone.bitplanes import TruthPlanes
from stone.signature import Signature


def validate(zip_path: Path, manifest_path: Path, *, threads: int = THREADS, progress: Progress = silent) -> Validation:
    """Everything that is wrong with a submission, short of what only the ground truth knows.

    Raises `UnreadableInputError` for a path that cannot be opened and `ManifestError` for a broken manifest.
    """
    manifest = read_manifest(manifest_path)
    with open_submission(zip_path, manifest.tokens) as submission:
        found = check_range(submission, manifest.tokens, threads=threads, progress=progress)
        return verdict([*submission.problems, *found])


def score(
    zip_path: Path,
    ground_truth_dir: Path,
    *,
    mask: Mask = "all",
    threads: int = THREADS,
    progress: Progress = silent,
) -> Scores:
    """The scores of a submission that holds exactly the frames of this ground truth.

    Raises `SubmissionRefusedError` with the whole validation, `GroundTruthError`, `UnreadableInputError`.
    """
    truth = find_ground_truth(ground_truth_dir, mask)
    paths, hashes = truth.paths(), dict[str, bytes]()

    def truth_of(token: str) -> TruthPlanes:
        planes = read_truth(paths[token], mask)
        hashes[token] = truth_hash(planes)
        return planes

    with open_submission(zip_path, truth.manifest.tokens) as submission:
        counted = count(submission, truth.manifest.tokens, truth_of, threads=threads, progress=progress)
    sequences = tuple(SequenceFacts(name, len(tokens)) for name, tokens in truth.manifest.sequences.items())
    return Scores(Tally(counted.confusions, counted.bev, sequences), Signature(whole_hash(hashes), truth.mask))


def count(
    submission: Submission,
    tokens: Sequence[str],
    truth_of: TruthOf,
    *,
    threads: int = THREADS,
    progress: Progress = silent,
) -> Counted:
    """The counts of these frames of a submission that is valid.

    Raises `SubmissionRefusedError`; an archive whose names are wrong is refused before any frame is counted.
    """
    if submission.problems:
        raise SubmissionRefusedError(verdict(submission.problems))
    counted = count_range(submission, tokens, truth_of, threads=threads, progress=progress)
    if counted.problems:
        raise SubmissionRefusedError(verdict(counted.problems))
    return counted
