"""Routes of the viewer's scene: the labels' metadata, and the map by tiles.

**Conventions.** `services/domain/viewer/formats.py` describes the binary formats. A URL with `v`, the id of the label
set (for cameras, of the playback), never changes its content; without it a browser must revalidate its copy.
"""

from typing import Annotated

from fastapi import APIRouter, Path, Query, Request, Response

from api.answers import refusals
from api.deps import Looker, PlatformDep
from api.files import GeneratedFile, answer_bytes, answer_file, answer_made, file_responses
from api.schemas.base import ID_PATTERN, IdPath
from api.schemas.sequences.scenes import SceneDetail
from api.views.scenes import VersionQuery, played_cameras, scene_bytes, scene_file, scene_of
from services.domain.viewer.formats import MEDIA_TYPES

router = APIRouter(prefix="/sequences/{sequence_id}/scene", tags=["viewer"])
TilePath = Annotated[str, Path(pattern=r"^-?\d{1,7}_-?\d{1,7}(_\d{1,4})?$", examples=["0_-1"])]
JSON = "application/json"
BINARY = "application/octet-stream"
CAMERAS = MEDIA_TYPES["STR1"]
PlaybackQuery = Annotated[
    str | None,
    Query(alias="v", pattern=ID_PATTERN, description="Id of the playback; caches may then keep the answer."),
]


@router.get(
    "",
    summary="Show the scene of the 3D view",
    response_class=Response,
    responses={200: {"model": SceneDetail}, 304: {"description": "The caller's copy is current"}, **refusals(404)},
)
def show_scene(sequence_id: IdPath, caller: Looker, platform: PlatformDep, request: Request) -> Response:
    """Return the grid, the frames with their poses, the tiles of the map, and the playback."""
    with platform.database.reading() as session:
        scene = scene_of(session, caller, sequence_id)
    return answer_made(request, scene_bytes(platform.store, scene), GeneratedFile(JSON, scene.file.filename))


@router.get(
    "/cameras",
    response_class=Response,
    responses=file_responses(CAMERAS),
    summary="Download the camera poses and lens rays (STR1)",
)
def download_scene_cameras(
    sequence_id: IdPath,
    caller: Looker,
    platform: PlatformDep,
    request: Request,
    version: PlaybackQuery = None,
) -> Response:
    """Return the poses and rays that place the playback's pictures over the labels; 404 `no_playback` without a
    playback.
    """
    return answer_bytes(request, played_cameras(platform, (caller, sequence_id, version)))


@router.get("/tiles/{tile_name}", response_class=Response, responses=file_responses(BINARY))
def download_scene_tile(
    sequence_id: IdPath,
    tile_name: TilePath,
    caller: Looker,
    platform: PlatformDep,
    request: Request,
    version: VersionQuery = None,
) -> Response:
    """Download the labelled voxels of a tile: class, elevation, slope, roughness and D² of each (`STT1`)."""
    with platform.database.reading() as session:
        file = scene_file(session, caller, sequence_id, f"tile_{tile_name}", version)
    return answer_file(request, platform.store, file)


@router.get(
    "/meshes/{tile_name}",
    summary="Download the surface of a tile (STM1)",
    response_class=Response,
    responses=file_responses(BINARY),
)
def download_scene_mesh(
    sequence_id: IdPath,
    tile_name: TilePath,
    caller: Looker,
    platform: PlatformDep,
    request: Request,
    version: VersionQuery = None,
) -> Response:
    """Return the thinned surface; each vertex has a class."""
    with platform.database.reading() as session:
        file = scene_file(session, caller, sequence_id, f"mesh_{tile_name}", version)
    return answer_file(request, platform.store, file)
