"""Routes of the viewer's frame data: voxels, top-down picture, camera images, point cloud, radar detections.

**Conventions.** Voxels and picture are made from the labels at each request, which is faster than reading a stored
copy. Camera images and sweeps come from the playback (`services/domain/viewer/playback.py`).
"""

from dataclasses import replace
from functools import partial
from typing import Annotated

from fastapi import APIRouter, Path, Request, Response

from api.deps import Looker, PlatformDep
from api.files import GeneratedFile, answer_bytes, answer_made, file_responses
from api.routes.sequences.frames import TokenPath
from api.views.scenes import ColoursQuery, VersionQuery, frame_picture, frame_voxels, labels_file, played_file
from services.domain.viewer.formats import MEDIA_TYPES
from services.domain.viewer.playback import camera_file, cloud_file, radar_file

router = APIRouter(prefix="/frames/{token}", tags=["viewer"])
ChannelPath = Annotated[str, Path(pattern=r"^[A-Z][A-Z0-9_]{0,63}$", examples=["CAM_FRONT"])]
VOXELS, CLOUD, RADAR = (MEDIA_TYPES[magic] for magic in ("STV1", "STC1", "STE1"))
PNG, JPEG = "image/png", "image/jpeg"


@router.get(
    "/voxels",
    summary="Download a frame's voxels (STV1)",
    response_class=Response,
    responses=file_responses(VOXELS),
)
def download_voxels(
    token: TokenPath, caller: Looker, platform: PlatformDep, request: Request, version: VersionQuery = None
) -> Response:
    """Return the class of each voxel and whether LiDAR and camera observed it, three bits each."""
    with platform.database.reading() as session:
        file = labels_file(session, caller, token, version)
    facts = GeneratedFile(VOXELS, f"{token}-voxels.bin", file.is_lasting)
    return answer_made(request, frame_voxels(platform.store, file), facts)


@router.get("/bev.png", response_class=Response, responses=file_responses(PNG))
def download_frame_picture(
    token: TokenPath,
    caller: Looker,
    platform: PlatformDep,
    request: Request,
    version: VersionQuery = None,
    colours: ColoursQuery = "default",
) -> Response:
    """Download the labels from above, forward up; unobserved voxels are grey, the ground is transparent."""
    with platform.database.reading() as session:
        file = labels_file(session, caller, token, version)
    facts = GeneratedFile(PNG, f"{token}-bev.png", file.is_lasting)
    return answer_made(request, frame_picture(platform.store, file, colours), facts)


@router.get("/camera/{channel}.jpg", response_class=Response, responses=file_responses(JPEG))
def download_camera_picture(
    token: TokenPath,
    channel: ChannelPath,
    caller: Looker,
    platform: PlatformDep,
    request: Request,
    version: VersionQuery = None,
) -> Response:
    """Download a camera's picture, at most 640 pixels wide; 404 `no_playback` without a playback."""
    served = played_file(platform, (caller, token, version), partial(camera_file, channel))
    return answer_bytes(request, replace(served, media_type=JPEG))


@router.get(
    "/cloud", summary="Download a frame's point cloud (STC1)", response_class=Response, responses=file_responses(CLOUD)
)
def download_point_cloud(
    token: TokenPath, caller: Looker, platform: PlatformDep, request: Request, version: VersionQuery = None
) -> Response:
    """Return at most 40,000 points in the ego frame; 404 `no_playback` without a playback."""
    served = played_file(platform, (caller, token, version), cloud_file)
    return answer_bytes(request, replace(served, media_type=CLOUD))


@router.get(
    "/radar",
    summary="Download a frame's radar detections (STE1)",
    response_class=Response,
    responses=file_responses(RADAR),
)
def download_radar(
    token: TokenPath, caller: Looker, platform: PlatformDep, request: Request, version: VersionQuery = None
) -> Response:
    """Return the detections of all radars in the ego frame at the frame's stamp, with speeds over ground."""
    served = played_file(platform, (caller, token, version), radar_file)
    return answer_bytes(request, replace(served, media_type=RADAR))
