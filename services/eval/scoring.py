"""Scores from counts: the record, the intervals and the two stored files of a score."""

from hashlib import sha256
from secrets import token_hex

from services.domain.benchmarks.phases.evaluation_versions import EvaluationVersion
from services.domain.benchmarks.submissions.scores import NewScore
from services.eval.cases import Case, ReadyTruth
from services.eval.ranges import Counts
from services.eval.score_intervals import spectra_npz
from services.eval.scores import SequenceFacts, SubmissionCounts, record_of
from services.eval.stage_context import EvalStageContext
from services.runtime.code_version import code_version
from services.runtime.store.blobs import PreparedBlob, prepare
from stone.scoring.signature import Signature
from stone_files.npz import npz_bytes


def made_score(
    context: EvalStageContext, case: Case, evaluation_version: EvaluationVersion, counts: Counts
) -> NewScore:
    """The score of these counts, its files stored; it bears the version of the code that counted.

    Raises `UnknownMetricError`, and what the store raises.
    """
    counts_of_frames = SubmissionCounts(counts.confusions, counts.bev, sequences_of(case.truth))
    spectra = counts_of_frames.spectra(evaluation_version.metric)
    return NewScore(
        submission_id=case.submission_id,
        evaluation_version=evaluation_version,
        signature=str(Signature(case.truth.sha256, case.truth.mask, evaluation_version.metric)),
        record={
            "code_version": case.kept.code_version if case.kept else code_version("scores"),
            **record_of(counts_of_frames, spectra, evaluation_version.metric),
        },
        confusions=_stored(context, npz_bytes({"confusions": counts.confusions, "bev": counts.bev})),
        spectra=_stored(context, spectra_npz(spectra)),
        content_sha256=sha256(counts.confusions.astype("<i4").tobytes()).hexdigest(),
    )


def sequences_of(truth: ReadyTruth) -> tuple[SequenceFacts, ...]:
    """The sequences of a ground truth in the order of its frames."""
    return tuple(
        SequenceFacts(one["name"], one["frames"], one["environment"] or None, one["illumination"] or None)
        for one in truth.facts["sequences"]
    )


def _stored(context: EvalStageContext, content: bytes) -> PreparedBlob:
    """Each attempt writes a file of its own: what is stored may share its bytes, so none is written twice."""
    path = context.folder / f"{token_hex(8)}.npz"
    path.write_bytes(content)
    return prepare(context.platform.store, context.platform.database, path, adopt=True)
