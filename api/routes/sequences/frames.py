"""Routes of single frames by token: their place in a sequence, and their labels.

**Conventions.** Everyone with the bag can compute its tokens, so a token grants no access: other users' frames are 404.
The labels of a frame are a range of a pack, served as a separate file with its own sha256.
"""

from typing import Annotated

from fastapi import APIRouter, Path, Request, Response

from api.answers import refusals
from api.deps import Looker, PlatformDep
from api.files import answer_file, file_responses
from api.schemas.base import ID_EXAMPLE, ID_PATTERN
from api.schemas.sequences.sequences import FrameDetail
from api.views.scenes import NPZ, labels_file
from api.visible import frame_of

router = APIRouter(prefix="/frames/{token}", tags=["frames"])
TokenPath = Annotated[str, Path(pattern=ID_PATTERN, examples=[ID_EXAMPLE])]


@router.get("", responses=refusals(404))
def show_frame(token: TokenPath, caller: Looker, platform: PlatformDep) -> FrameDetail:
    """Show a labelled frame and its origin."""
    with platform.database.reading() as session:
        frame, labels = frame_of(session, caller, token)
    return FrameDetail.of(
        frame,
        sequence_id=labels.sequence_id,
        label_set_id=labels.id,
        labels_bytes=frame.length_bytes,
        labels_sha256=frame.sha256,
        parameters=labels.parameters,
    )


@router.get(
    "/labels.npz", summary="Download a frame's labels (npz)", response_class=Response, responses=file_responses(NPZ)
)
def download_labels(token: TokenPath, caller: Looker, platform: PlatformDep, request: Request) -> Response:
    """Return the arrays `semantics`, `mask_lidar` and `mask_camera` of a frame, each (256, 256, 32) uint8."""
    with platform.database.reading() as session:
        file = labels_file(session, caller, token)
    return answer_file(request, platform.store, file)
