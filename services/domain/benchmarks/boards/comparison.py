"""Comparison of two entries of a phase: differences and their significance.

**Conventions.** Differences are a − b by the active evaluation version. Spectra are subtracted, so difficulties that
both entries share cancel. `these_places` is about the ground of the ground truth, `new_place` about unseen places, with
an exact test over the few sequences. If nothing can be stated, the code of the silence is given. While a phase hides
its ground truth, only differences of rounded totals are shown.
"""

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from sqlalchemy.orm import Session

from services.domain.benchmarks.phases.evaluation_versions import active
from services.domain.benchmarks.submissions.result_errors import NotScoredError
from services.domain.benchmarks.submissions.results import ScoreView, seen_score
from services.domain.benchmarks.visibility import Viewer, rounded
from services.runtime.orm import Blob, Phase, SubmissionRow
from services.runtime.platform import Platform
from services.runtime.store.protocol import Store
from stone.errors import Refused
from stone.scoring.intervals import SCOPES, WITHDRAWN, Estimate, RatioSpectra, Scope, Silence, estimates
from stone.scoring.metric import RATIOS
from stone.scoring.ranking import SignFlip, sign_flip
from stone.scoring.spectra import layout_of

Found = Mapping[Scope, tuple[Estimate | Silence, ...]]


@dataclass(frozen=True)
class DifferenceEstimate:
    """Confidence interval of a − b at the board's level, and the two-sided p."""

    interval: tuple[float, float]
    standard_error: float
    degrees_of_freedom: float
    p: float


@dataclass(frozen=True)
class RatioDifference:
    """The difference of one ratio, null if undefined or withheld; an estimate or a silence for each scope."""

    a: float | None
    b: float | None
    difference: float | None
    these_places: DifferenceEstimate | None = None
    new_place: DifferenceEstimate | None = None
    silences: Mapping[Scope, Silence | None] | None = None
    sign_flip: SignFlip | None = None


@dataclass(frozen=True)
class EntryComparison:
    """A comparison of two entries; `is_withheld` if the viewer may see only the differences of their totals."""

    a: ScoreView
    b: ScoreView
    ratios: Mapping[str, RatioDifference]
    is_withheld: bool


def compare(
    platform: Platform, phase_id: str, pair: tuple[SubmissionRow, SubmissionRow], viewer: Viewer
) -> EntryComparison:
    """Compare two submissions that the viewer may see. Raises `not_comparable`, `store_unavailable`."""
    with platform.database.reading() as session:
        phase = session.get_one(Phase, phase_id)
        a, b = (_require_scored(session, viewer, phase, submission) for submission in pair)
        keys = [session.get_one(Blob, seen.score.spectra_sha256).object_key for seen in (a, b)]
    is_withheld = not (a.policy.shows("comparison") and b.policy.shows("comparison"))
    totals = {name: _totals(a, b, name) for name in RATIOS}
    if is_withheld:
        return EntryComparison(a, b, totals, True)
    estimates = _differences(platform.store, keys, [totals[name].difference for name in RATIOS])
    compared = {
        name: replace(_compare_ratio(totals[name], estimates, column), sign_flip=_test_sign_flips(a, b, name))
        for column, name in enumerate(RATIOS)
    }
    return EntryComparison(a, b, compared, False)


def _differences(store: Store, keys: Sequence[str], values: Sequence[float | None]) -> Found:
    """Return, for each scope and ratio, an estimate or a silence."""
    a, b = (read_spectra(store, key) for key in keys)
    if a is None or b is None:
        return dict.fromkeys(SCOPES, (WITHDRAWN,) * len(RATIOS))
    of_ratios = np.array([np.nan if value is None else value for value in values], np.float64)
    return {scope: estimates(of_ratios, a.minus(b), scope) for scope in SCOPES}


def _compare_ratio(totals: RatioDifference, estimates: Found, column: int) -> RatioDifference:
    of_ratio = {scope: of_scope[column] for scope, of_scope in estimates.items()}
    known = {scope: _clip(estimate) for scope, estimate in of_ratio.items() if isinstance(estimate, Estimate)}
    silences = {scope: None if isinstance(estimate, Estimate) else estimate for scope, estimate in of_ratio.items()}
    return replace(totals, these_places=known.get("these_places"), new_place=known.get("new_place"), silences=silences)


def _clip(estimate: Estimate) -> DifferenceEstimate:
    low, high = estimate.interval()
    return DifferenceEstimate((max(low, -1.0), min(high, 1.0)), estimate.error, estimate.degrees, estimate.p)


def _require_scored(session: Session, viewer: Viewer, phase: Phase, submission: SubmissionRow) -> ScoreView:
    if submission.phase_id != phase.id or active(session, phase.id) is None:
        raise not_comparable(submission.id, phase.name)
    try:
        return seen_score(session, viewer, submission)
    except NotScoredError as error:
        raise not_comparable(submission.id, phase.name) from error


def _totals(a: ScoreView, b: ScoreView, name: str) -> RatioDifference:
    of_a, of_b = (seen.policy.ratio(getattr(seen.score, name)) for seen in (a, b))
    is_exact = a.policy.shows("exact") and b.policy.shows("exact")
    return RatioDifference(of_a, of_b, _difference(of_a, of_b, is_exact))


def _test_sign_flips(a: ScoreView, b: ScoreView, name: str) -> SignFlip | None:
    """Return the sign-flip test over the drives in which both entries have the ratio."""
    by = (seen.score.record["by"] for seen in (a, b))
    of_a, of_b = (parts.get("drive", parts.get("sequence", {})) for parts in by)
    both = [(of_a[key][name], of_b[key][name]) for key in of_a if key in of_b]
    known = [x - y for x, y in both if x is not None and y is not None]
    return sign_flip(known) if known else None


def _difference(a: float | None, b: float | None, is_exact: bool) -> float | None:
    """Return a − b of the totals as shown."""
    if a is None or b is None:
        return None
    return a - b if is_exact else rounded(a - b)


# Reads the stored spectra of a score. The platform wrote the file (`services/eval/spectra_file.py`), so its content is
# trusted. Scores whose metric's intervals are withdrawn may have another kind of file, which is ignored.


def read_spectra(store: Store, object_key: str) -> RatioSpectra | None:
    """Return the spectra of a score, or None if bootstrap replicates were stored. Raises `store_unavailable`."""
    with np.load(io.BytesIO(b"".join(store.read(object_key))), allow_pickle=False) as arrays:
        if "coefficients" not in arrays:
            return None
        return RatioSpectra(
            layout_of(arrays["frames_of_sequence"].tolist()),
            arrays["coefficients"],
            arrays["sequence_weight"],
            arrays["spread"],
        )


def not_comparable(submission_id: str, phase: str) -> Refused:
    return Refused(
        "not_comparable",
        f"submission {submission_id} has no score by the active evaluation version of phase {phase!r}; only scored "
        "entries of this phase can be compared",
    )
