"""From a submitted zip to a verdict, and from a valid one to scores. Read this first.

**Conventions.** Nothing here starts a process or keeps state, so it runs as it is in a child with memory and time
limits. Peak memory does not grow with the submission, but for 192 bytes a frame.
"""

from collections.abc import Callable
from hashlib import sha256
from itertools import accumulate
from pathlib import Path

from services.eval.counting import Progress, count_frame, empty_confusions, in_threads, silent, validate_frame
from services.eval.ground_truth import GroundTruth, Mask, find_ground_truth, read_truth, truth_hash
from services.eval.manifest import Manifest, read_manifest
from services.eval.scores import Scores
from services.eval.submission_zip import Submission, open_submission
from services.eval.validation import Problem, SubmissionRefusedError, Validation, verdict
from stone.bitplanes import Confusion, TruthPlanes
from stone.confusion import Signature

THREADS = 2

TruthOf = Callable[[str], TruthPlanes]


def validate(zip_path: Path, manifest_path: Path, *, threads: int = THREADS, progress: Progress = silent) -> Validation:
    """Everything that is wrong with a submission, short of what only the ground truth knows.

    Raises `UnreadableInputError` for a path that cannot be opened and `ManifestError` for a broken manifest.
    """
    manifest = read_manifest(manifest_path)
    with open_submission(zip_path, manifest.tokens) as submission:
        tokens = _in_manifest_order(submission, manifest)
        found = in_threads(
            lambda index: validate_frame(submission, tokens[index]),
            len(tokens),
            threads,
            progress=progress,
            stage="validate",
        )
        return verdict([*submission.problems, *(problem for problem in found if problem is not None)])


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
        confusions = count(submission, truth.manifest, truth_of, threads=threads, progress=progress)
    return Scores(truth.manifest.tokens, _runs(truth.manifest), confusions, _signature(truth, hashes))


def count(
    submission: Submission,
    manifest: Manifest,
    truth_of: TruthOf,
    *,
    threads: int = THREADS,
    progress: Progress = silent,
) -> Confusion:
    """Confusions [frame, ring, 4, 4] in the order of the manifest, every check on.

    Raises `SubmissionRefusedError`; an archive whose names are wrong is refused before any frame is counted.
    """
    if submission.problems:
        raise SubmissionRefusedError(verdict(submission.problems))
    tokens, confusions = manifest.tokens, empty_confusions(len(manifest.tokens))

    def one(index: int) -> Problem | None:
        return count_frame(submission, tokens[index], truth_of(tokens[index]), confusions[index])

    found = verdict(p for p in in_threads(one, len(tokens), threads, progress=progress, stage="score") if p is not None)
    if not found.ok:
        raise SubmissionRefusedError(found)
    return confusions


def _in_manifest_order(submission: Submission, manifest: Manifest) -> tuple[str, ...]:
    return tuple(token for token in manifest.tokens if token in submission.frames)


def _runs(manifest: Manifest) -> dict[str, slice]:
    stops = list(accumulate(len(tokens) for tokens in manifest.sequences.values()))
    starts = [0, *stops[:-1]]
    return dict(zip(manifest.sequences, map(slice, starts, stops), strict=True))


def _signature(truth: GroundTruth, hashes: dict[str, bytes]) -> Signature:
    whole = sha256(b"".join(token.encode() + hashes[token] for token in sorted(hashes)))
    return Signature(ground_truth=whole.hexdigest(), mask=truth.mask)
