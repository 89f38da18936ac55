"""Counts → a score: record, intervals and the two files that are kept, ready to be written with the job's success."""

from hashlib import sha256
from secrets import token_hex

from services.eval.cases import Case, Truth
from services.eval.desk import Desk
from services.eval.draws import ratio_draws
from services.eval.examining import Counts
from services.eval.scores import SequenceFacts, Tally, record_of
from services.runtime.benchmarks.pairs import Pair
from services.runtime.benchmarks.scores import NewScore
from services.runtime.blobs import PreparedBlob, prepare
from services.runtime.npz import npz_bytes
from services.runtime.recipes import CODE_VERSION
from stone.signature import Signature


def made_score(desk: Desk, case: Case, pair: Pair, counts: Counts) -> NewScore:
    """The score of these counts, its files stored. Raises `UnknownMetricError`, and what the store raises."""
    tally = Tally(counts.confusions, counts.bev, sequences_of(case.truth))
    draws = ratio_draws(tally.confusions, tally.frames_of_sequence, pair.metric)
    return NewScore(
        submission_id=case.submission_id,
        pair=pair,
        signature=str(Signature(case.truth.sha256, case.truth.mask, pair.metric)),
        record={"code_version": CODE_VERSION, **record_of(tally, draws, pair.metric)},
        confusions=_stored(desk, npz_bytes({"confusions": counts.confusions, "bev": counts.bev})),
        draws=_stored(desk, draws.npz()),
        content_sha256=sha256(counts.confusions.astype("<i4").tobytes()).hexdigest(),
    )


def sequences_of(truth: Truth) -> tuple[SequenceFacts, ...]:
    """The sequences of a ground truth in the order of its frames."""
    return tuple(
        SequenceFacts(one["name"], one["frames"], one["environment"] or None, one["illumination"] or None)
        for one in truth.facts["sequences"]
    )


def _stored(desk: Desk, content: bytes) -> PreparedBlob:
    """Each attempt writes a file of its own: what is stored may share its bytes, so none is written twice."""
    path = desk.folder / f"{token_hex(8)}.npz"
    path.write_bytes(content)
    return prepare(desk.platform.store, desk.platform.database, path, adopt=True)
