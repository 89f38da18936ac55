"""Routes of top-view frame pictures: the ground truth of an open phase, a prediction of it, their difference.

**Conventions.** Pictures exist only for phases with open ground truth and for sequences that nothing hides. Hidden
phases have no pictures for anyone, including administrators, even after their end. The dataset's downloads provide the
grids. Access is checked at each request, before cached pictures are looked up.
"""

from functools import lru_cache
from typing import Annotated, Literal

import numpy as np
from fastapi import APIRouter, Query, Request, Response
from numpy.typing import NDArray

from api.answers import refusals
from api.deps import Looker, PlatformDep
from api.errors import NotFoundError
from api.files import GeneratedFile, answer_made, file_responses
from api.routes.benchmarks import AT, AtPhase
from api.routes.sequences.frames import TokenPath
from api.schemas.base import IdPath
from api.schemas.results import ScoreQuery
from api.views.results import known_score
from api.views.scenes import ColoursQuery
from services.domain.benchmarks.phases.open_frames import (
    OpenFrames,
    OpenTruth,
    all_tokens,
    locate_open_truth,
    open_frames,
    open_truth_of,
    truth_grids,
)
from services.domain.benchmarks.submissions.predicted_frames import pictured_zip, predicted_grid
from services.domain.viewer.frame_picture import difference_picture, picture_bytes, recoloured
from services.runtime.store.pack_reading import ExportLocation
from services.runtime.store.protocol import Store
from stone_base.label_grid import LabelGrid

router = APIRouter(tags=["benchmarks"])
PNG = "image/png"
PICTURE = file_responses(PNG)
PREDICTED = PICTURE | refusals(403, 409)
HELD_PICTURES, HELD_GRIDS = 128, 4
Shown = Literal["prediction", "truth", "difference"]
ShowQuery = Annotated[
    Shown, Query(description="The predicted labels, the ground truth of this score, or their difference.")
]
Grid = NDArray[np.uint8]


@router.get(
    f"{AT}/frames/{{token}}.png",
    response_class=Response,
    responses=PICTURE,
    summary="Download the picture of a frame's ground truth",
)
def download_truth_picture(
    token: TokenPath, at: AtPhase, platform: PlatformDep, request: Request, colours: ColoursQuery = "default"
) -> Response:
    """Return the frame seen from above, forward up; only in open phases."""
    with platform.database.reading() as session:
        located = open_truth_of(session, at.find(session))
    frames = _showing(platform.store, located, token)
    content = _truth_picture(platform.store, (frames.located, frames.grid), token)
    return answer_made(request, recoloured(content, colours), GeneratedFile(PNG, f"{token}-truth.png"))


@router.get(
    "/submissions/{submission_id}/frames/{token}.png",
    response_class=Response,
    responses=PREDICTED,
    summary="Download the picture of a predicted frame",
)
def download_predicted_picture(
    submission_id: IdPath,
    token: TokenPath,
    caller: Looker,
    platform: PlatformDep,
    request: Request,
    show: ShowQuery = "prediction",
    score: ScoreQuery = None,
    colours: ColoursQuery = "default",
) -> Response:
    """Return the prediction from above, its ground truth, or their difference; only in open phases."""
    with platform.database.reading() as session:
        seen = known_score(session, caller, submission_id, score)
        key = pictured_zip(session, seen).object_key  # refused before the response reveals anything about the frame
        located = locate_open_truth(session, seen.phase, seen.truth)
    frames = _showing(platform.store, located, token)
    if show == "truth":
        content = _truth_picture(platform.store, (frames.located, frames.grid), token)
    else:
        content = _predicted_picture(platform.store, (key, frames.located, frames.grid), token, show)
    return answer_made(request, recoloured(content, colours), GeneratedFile(PNG, f"{token}-{show}.png"))


def _showing(store: Store, located: OpenTruth | None, token: str) -> OpenFrames:
    """Return the frames that may be shown, including this frame. Raises `NotFoundError`."""
    frames = open_frames(store, located) if located else None
    if frames is None or token not in frames.sequences:
        raise NotFoundError("frame of this phase", token)
    return frames


@lru_cache(maxsize=HELD_PICTURES)
def _truth_picture(store: Store, of: tuple[ExportLocation, LabelGrid], token: str) -> bytes:
    return picture_bytes(*_truth(store, of[0], token), of[1])


@lru_cache(maxsize=HELD_PICTURES)
def _predicted_picture(store: Store, of: tuple[str, ExportLocation, LabelGrid], token: str, show: Shown) -> bytes:
    """Return the picture. Raises `NotFoundError` if the zip lacks the frame, which accepted zips never do."""
    predicted = _predicted(store, of[:2], token)
    if predicted is None:
        raise NotFoundError("frame of this submission", token)
    truth, observed = _truth(store, of[1], token)
    return picture_bytes(predicted, observed, of[2]) if show == "prediction" else difference_picture(truth, predicted)


@lru_cache(maxsize=HELD_GRIDS)
def _truth(store: Store, located: ExportLocation, token: str) -> tuple[Grid, Grid]:
    return truth_grids(store, located, token)


@lru_cache(maxsize=HELD_GRIDS)
def _predicted(store: Store, of: tuple[str, ExportLocation], token: str) -> Grid | None:
    """Return the predicted grid; a bucket store downloads the whole zip once."""
    shape = _truth(store, of[1], token)[0].shape
    return predicted_grid(store.local(of[0]), all_tokens(store, of[1]), token, shape)
