"""Scenes and frames for the viewer: database rows and stored files become responses.

**Conventions.** Every function checks what the caller may see. Results for the last few frames are cached by the
process, because labels never change.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Annotated, Any

from fastapi import Query
from sqlalchemy import select
from sqlalchemy.orm import Session

from api.deps import Caller
from api.errors import NotFoundError
from api.files import ServedFile, StoredFile, read_whole
from api.schemas.base import ID_PATTERN
from api.views.exports import served_file
from api.visible import frame_of, newest_label_set, shown_sequence
from services.domain.viewer.formats import MEDIA_TYPES, voxels_bytes
from services.domain.viewer.frame_grids import stored_grids
from services.domain.viewer.frame_picture import Grid, picture_bytes, recoloured
from services.domain.viewer.playback import CAMERAS, Playback, playback_of, shown_by
from services.runtime.orm import Artefact, Blob, LabelSet, SequenceRow
from services.runtime.platform import Platform
from services.runtime.store.pack_reading import stored_files
from services.runtime.store.protocol import Store
from stone.errors import Refused
from stone.labels.class_colours import ColourName
from stone_base.label_grid import MAP_VOXEL_M, PAPER, LabelGrid, recorded_grid

HELD_SCENES, HELD_FRAMES = 16, 128
NPZ = "application/octet-stream"
VersionQuery = Annotated[
    str | None,
    Query(alias="v", pattern=ID_PATTERN, description="Id of the label set; caches may then keep the answer."),
]

ColoursQuery = Annotated[
    ColourName, Query(description="Colours of the classes; `paper` has the green, yellow and red of the paper.")
]


@dataclass(frozen=True)
class SceneLocation:
    """A label set of a sequence, the place of its `scene.json`, and the progress of its playback."""

    sequence_id: str
    label_set_id: str
    file: StoredFile
    playback: Playback


def scene_of(session: Session, caller: Caller, sequence_id: str) -> SceneLocation:
    """Return the scene of the newest labels. Raises `NotFoundError`, `no_scene`."""
    sequence = shown_sequence(session, caller, sequence_id)
    labels = newest_label_set(session, sequence.id)
    file = artefact_file(session, sequence, labels, "scene/scene.json")
    if file is None:
        raise Refused(
            "no_scene",
            f"the release that made labels {labels.id} had no viewer; process the sequence again",
        )
    return SceneLocation(sequence.id, labels.id, file, playback_of(session, labels.id))


def scene_bytes(store: Store, scene: SceneLocation) -> bytes:
    """Return the body of a `SceneDetail`; it reads the store, so it must not run within a transaction."""
    shown = shown_by(store, scene.playback)
    playback: dict[str, Any] = {"export_id": scene.playback.export_id, "state": scene.playback.state}
    playback |= shown.as_record()
    known: dict[str, Any] = {"sequence_id": scene.sequence_id, "label_set_id": scene.label_set_id}
    known |= {"has_confidence": False, "map_voxel_m": MAP_VOXEL_M}  # scenes of earlier releases lack them
    kept = _record(store, scene.file)
    record = {**known, **kept, "grid": {"name": PAPER.name, **kept["grid"]}, "playback": playback}
    return json.dumps(record, separators=(",", ":")).encode()


def scene_file(session: Session, caller: Caller, sequence_id: str, name: str, version: str | None) -> StoredFile:
    """Return a file of the scene of the newest labels. Raises `NotFoundError`."""
    sequence = shown_sequence(session, caller, sequence_id)
    labels = newest_label_set(session, sequence.id)
    file = artefact_file(session, sequence, labels, f"scene/{name}.bin")
    if file is None:
        raise NotFoundError("part of this scene", name)
    return replace(file, is_lasting=version == labels.id)


def labels_file(session: Session, caller: Caller, token: str, version: str | None = None) -> StoredFile:
    """Return the `labels.npz` of a frame. Raises `NotFoundError`."""
    frame, labels = frame_of(session, caller, token)
    pack = session.get_one(Artefact, frame.pack_id)
    object_key = session.get_one(Blob, pack.blob_sha256).object_key
    location = (object_key, frame.length_bytes, frame.sha256, NPZ, f"{token}-labels.npz", frame.offset_bytes)
    return StoredFile(*location, is_lasting=version == labels.id, grid=recorded_grid(labels.grid))


def frame_voxels(store: Store, labels: StoredFile) -> bytes:
    """Return `STV1` of these labels. Raises `grid_unreadable`."""
    return _made(store, labels, _placed_voxels)


def frame_picture(store: Store, labels: StoredFile, colours: ColourName) -> bytes:
    """Return these labels from above as a PNG. Raises `grid_unreadable`."""
    return recoloured(_made(store, labels, picture_bytes), colours)


def played_file(platform: Platform, asked: tuple[Caller, str, str | None], name: Callable[[str], str]) -> ServedFile:
    """Return a file of a frame's playback, for (caller, token, version) and its name by token.

    Raises `NotFoundError`, `no_playback`.
    """
    caller, token, version = asked
    with platform.database.reading() as session:
        _, labels = frame_of(session, caller, token)
        playback = playback_of(session, labels.id)
    if playback.located is None:
        raise no_playback(labels.id)
    stored = stored_files(platform.store, playback.located)
    return replace(served_file(platform.store, stored, name(token)), is_lasting=version == labels.id)


def played_cameras(platform: Platform, asked: tuple[Caller, str, str | None]) -> ServedFile:
    """Return `STR1` of the playback of the newest labels, for (caller, sequence, version).

    Its version is the playback, which can be made again from the same labels. Raises `NotFoundError`, `no_playback`.
    """
    caller, sequence_id, version = asked
    with platform.database.reading() as session:
        labels = newest_label_set(session, shown_sequence(session, caller, sequence_id).id)
        playback = playback_of(session, labels.id)
    if playback.located is None:
        raise no_playback(labels.id)
    served = served_file(platform.store, stored_files(platform.store, playback.located), CAMERAS)
    return replace(served, media_type=MEDIA_TYPES["STR1"], is_lasting=version == playback.export_id)


@lru_cache(maxsize=HELD_FRAMES)
def _made(store: Store, labels: StoredFile, make: Callable[[Grid, Grid, LabelGrid], bytes]) -> bytes:
    span = (labels.offset_bytes, labels.offset_bytes + labels.size_bytes)
    return make(*stored_grids(store, labels.object_key, span), labels.grid)


def _placed_voxels(semantics: Grid, observed: Grid, _grid: LabelGrid) -> bytes:
    return voxels_bytes(semantics, observed)


@lru_cache(maxsize=HELD_SCENES)
def _record(store: Store, file: StoredFile) -> dict[str, Any]:
    """Return the JSON of an object, cached because objects never change."""
    record: dict[str, Any] = json.loads(read_whole(store, file))
    return record


def artefact_file(session: Session, sequence: SequenceRow, labels: LabelSet | None, name: str) -> StoredFile | None:
    """Return a file of these labels, named after the sequence; None without labels or such a file."""
    if labels is None:
        return None
    named = select(Artefact, Blob).join(Blob, Blob.sha256 == Artefact.blob_sha256)
    row = session.execute(named.where(Artefact.label_set_id == labels.id, Artefact.name == name)).one_or_none()
    if row is None:
        return None
    artefact, blob = row
    filename = f"{sequence.name}-{name.replace('/', '-')}"
    return StoredFile(blob.object_key, blob.size_bytes, blob.sha256, artefact.media_type, filename)


def no_playback(label_set_id: str) -> Refused:
    return Refused(
        "no_playback",
        f"labels {label_set_id} have no playback: its job is unfinished, or it was switched off or deleted. "
        "To create it, start an export of format playback",
    )
