"""Routes of a submission's results: totals, breakdowns, provenance, confusion counts, its zip.

**Conventions.** Its team, administrators and, while it is on a board, all users can see a submission. Visibility of its
parts is checked when they are read; a part withheld as a whole returns 403. The default `score` is the one by the
active pair; older scores stay readable by their ids.
"""

from fastapi import APIRouter, Request, Response

from api.answers import refusals
from api.deps import Looker, PlatformDep, Reader
from api.files import StoredFile, answer_file, file_responses
from api.schemas.base import IdPath
from api.schemas.results import BreakdownAnswer, ByQuery, ProvenanceAnswer, ResultsAnswer, ScoreQuery
from api.views.results import (
    breakdown_answer,
    known_score,
    known_submission,
    provenance_answer,
    results_answer,
    viewer_for,
)
from services.domain.benchmarks.submissions.predicted_frames import downloadable_zip
from services.domain.benchmarks.submissions.results import breakdown, kept_confusions, provenance, results
from services.runtime.orm import Blob
from services.runtime.platform import Platform

router = APIRouter(prefix="/submissions/{submission_id}", tags=["submissions"])
NPZ_TYPE = "application/octet-stream"
NPZ = file_responses(NPZ_TYPE) | refusals(403, 409)
ZIP_TYPE = "application/zip"
ZIP = file_responses(ZIP_TYPE) | refusals(403, 409)
PART = refusals(403, 404, 409)


@router.get("/results", summary="Show a submission's results", responses=refusals(404, 409))
def show_results(
    submission_id: IdPath, caller: Looker, platform: PlatformDep, score: ScoreQuery = None
) -> ResultsAnswer:
    """Return totals with intervals, supports and extra figures, as far as the caller may see them."""
    with platform.database.reading() as session:
        viewer = viewer_for(session, caller)
        shown = results(session, viewer, known_submission(session, viewer, submission_id), score)
        return results_answer(session, viewer, shown)


@router.get(
    "/results/breakdowns", summary="Show the result by sequence, environment, illumination or distance", responses=PART
)
def show_breakdown(
    submission_id: IdPath, by: ByQuery, caller: Looker, platform: PlatformDep, score: ScoreQuery = None
) -> BreakdownAnswer:
    """Return the groups; for a hidden phase, only after its end."""
    with platform.database.reading() as session:
        seen = known_score(session, caller, submission_id, score)
        return breakdown_answer(seen, by, breakdown(seen, by))


@router.get("/provenance", summary="Show the sources of a score", responses=PART)
def show_provenance(
    submission_id: IdPath, caller: Looker, platform: PlatformDep, score: ScoreQuery = None
) -> ProvenanceAnswer:
    """Return hashes, versions, signature and times."""
    with platform.database.reading() as session:
        return provenance_answer(provenance(known_score(session, caller, submission_id, score)))


@router.get(
    "/confusions", summary="Download the confusion counts by frame (npz)", response_class=Response, responses=NPZ
)
def download_confusions(
    submission_id: IdPath, caller: Looker, platform: PlatformDep, request: Request, score: ScoreQuery = None
) -> Response:
    """Return the counts that all figures of the result are computed from.

    `confusions` are [frame, ring, truth, prediction]; `bev` are [frame, ring, in both, in truth only, in prediction
    only]. Frames are in the order of the manifest.
    """
    with platform.database.reading() as session:
        blob = kept_confusions(session, known_score(session, caller, submission_id, score))
    return _kept(request, platform, blob, (NPZ_TYPE, f"{submission_id}.confusions.npz"))


@router.get(
    "/predictions.zip", response_class=Response, responses=ZIP, summary="Download the zip of a scored submission"
)
@router.head(
    "/predictions.zip",
    response_class=Response,
    responses=ZIP,
    summary="Show size and checksum of the zip of a scored submission",
    name="describe_predictions",
    description="Show size and checksum of the zip of a scored submission.",
)
def download_predictions(
    submission_id: IdPath, caller: Reader, platform: PlatformDep, request: Request, score: ScoreQuery = None
) -> Response:
    """Return your own zip as it was sent, or the zip of a baseline of an open phase."""
    with platform.database.reading() as session:
        blob = downloadable_zip(session, known_score(session, caller, submission_id, score))
    return _kept(request, platform, blob, (ZIP_TYPE, f"{submission_id}.zip"))


def _kept(request: Request, platform: Platform, blob: Blob, named: tuple[str, str]) -> Response:
    """Return a stored file, with its type and name."""
    file = StoredFile(blob.object_key, blob.size_bytes, blob.sha256, *named)
    return answer_file(request, platform.store, file)
