"""Rows that exist in the database before a route is called: uploads, labels, runs.

**Conventions.** Tests create everything that the API can create through the API; this module creates only results of
workers, as rows and blobs of the real store.
"""

import json
from collections.abc import Mapping
from collections.abc import Sequence as Listing
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import numpy as np
from sqlalchemy import select

from services.domain.exports.requests import ExportResult, start_export, write_export
from services.domain.sequences.label_comparisons import start_comparison
from services.domain.viewer.playback import (
    CAMERAS,
    INDEX,
    PLAYBACK,
    PlacedSensor,
    PlaybackChannels,
    camera_file,
    cloud_file,
    index_record,
    radar_file,
)
from services.runtime.jobs.enqueue import enqueue, enqueue_run
from services.runtime.jobs.specs import Context, JobSpec
from services.runtime.orm import Artefact, Job, LabelledFrameRow, LabelSet, Recording, SequenceRow, Upload, new_id
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.store import blobs
from services.runtime.store.pack_reading import archive_sha256, local_reader
from services.runtime.store.packs import index_bytes, pack_folder
from services.runtime.uploads import upload_file
from stone.sensors.sequence import frame_token
from stone_base.label_grid import PAPER, LabelGrid, record_unless_paper
from stone_files.archives import KINDS
from stone_files.grid_file import grid_text
from stone_files.npz import npz_bytes
from testing.api.serving import Person
from testing.worlds.frame_tables import FRAME_NS, frame_table_bytes

NOBODY = "0" * 32
START_NS = 1_777_800_000_000_000_000


def stamp_of(ordinal: int) -> int:
    """Return the stamp of a frame of a created label set, in nanoseconds."""
    return START_NS + ordinal * FRAME_NS


@dataclass(frozen=True)
class Labels:
    """A label set in the store: the bytes of each artefact and of each frame's labels, by name and by token."""

    id: str
    files: Mapping[str, bytes]
    frames: Mapping[str, bytes]


def sequence(api: httpx.Client, owner: Person, name: str = "forest", **said: str) -> dict[str, Any]:
    """Create a sequence through the API."""
    answer = api.post("/api/v1/sequences", json={"name": name, **said}, headers=owner.headers)
    assert answer.status_code == 201, answer.text
    made: dict[str, Any] = answer.json()
    return made


def upload(platform: Platform, owner: Person, content: bytes = b"bag", **columns: Any) -> str:
    """Create an upload with all its bytes on disk; return its id."""
    row = Upload(id=new_id(), owner_id=owner.user_id, purpose="recording", filename="run.mcap", state="complete")
    row.length_bytes, row.sha256, row.expires_ns = len(content), sha256(content).hexdigest(), now_ns() + 10**12
    for key, value in columns.items():
        setattr(row, key, value)
    path = upload_file(platform.settings, row.id)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    with platform.database.transaction() as session:
        session.add(row)
    return row.id


def labels(
    platform: Platform,
    made: Mapping[str, Any],
    frames: int = 3,
    seed: bytes = b"",
    contents: Listing[bytes] = (),
    grid: LabelGrid = PAPER,
) -> Labels:
    """Create a label set of the sequence at a grid, as the labeler publishes it; `seed` distinguishes the contents.

    With `contents` the frames' label files are these.
    """
    contents = contents or [seed + b"labels of %d " % i * (i + 1) for i in range(frames)]
    frames = len(contents)
    of_frames = {frame_token(made["name"], stamp_of(i)): content for i, content in enumerate(contents)}
    files = {
        "report.json": b'{"frames": %d, "seed": "%s"}' % (frames, seed),
        "mesh.ply": b"ply\n" + seed + bytes(range(256)) * 40,
        "frames.parquet": frame_table_bytes(list(of_frames), START_NS, seed),
        "bev.png": b"\x89PNG\r\n" + seed,
        "sequence.npz": b"PK" + seed,
        "grid.json": grid_text(grid).encode(),
        "labels/000000.pack": b"".join(of_frames.values()),
        "scene/scene.json": scene_json(made["name"], list(of_frames)),
        "scene/tile_0_-1.bin": b"STT1" + seed,
        "scene/mesh_0_-1.bin": b"STM1" + seed,
    }
    with platform.database.transaction() as session:
        run = enqueue_run(session, "sequence.process", [JobSpec("ingest.synchronise")], _context(made))
        run.state, run.arguments = "succeeded", {"recipe": seed.hex()}
        row = LabelSet(sequence_id=made["id"], job_id=run.id, recipe=new_id() * 2, parameters={"profile": "paper"})
        row.code_version, row.frames, row.grid = "1", frames, record_unless_paper(grid)
        row.duration_ns, row.distance_m = 25 * 10**9, 30.5
        row.free_voxels, row.t_voxels, row.p_voxels, row.n_voxels = 9000, 100, 200, 700
        row.held_out_recall, row.held_out_m = 0.9731, 75.4
        row.gravest_code, row.gravest_severity = "LAB-605", "warning"
        session.add(row)
        session.flush()
        artefacts = {name: _artefact(session, platform, row.id, name, content) for name, content in files.items()}
        offset = 0
        for ordinal, (token, content) in enumerate(of_frames.items()):
            frame = LabelledFrameRow(label_set_id=row.id, ordinal=ordinal, token=token, stamp_ns=stamp_of(ordinal))
            frame.pack_id, frame.offset_bytes, frame.length_bytes = (
                artefacts["labels/000000.pack"],
                offset,
                len(content),
            )
            frame.sha256 = sha256(content).hexdigest()
            session.add(frame)
            offset += len(content)
    return Labels(row.id, files, of_frames)


@cache
def frame_labels(kind: int = 1) -> bytes:
    """Return the `labels.npz` of a frame in which one voxel has this class, and its column was observed."""
    semantics, seen = (np.zeros((256, 256, 32), np.uint8) for _ in range(2))
    semantics[128, 100, 9], seen[128, 100] = kind, 1
    return npz_bytes({"semantics": semantics, "mask_lidar": seen, "mask_camera": seen})


def playback(platform: Platform, sequence_id: str, tokens: Listing[str], content: bytes = b"") -> str:
    """Create a playback of these frames and return its id; each file contains `content`.

    A sequence without a recording gets one.
    """
    with platform.database.transaction() as session:
        if session.scalar(select(Recording.id).where(Recording.sequence_id == sequence_id).limit(1)) is None:
            facts = {"sequence_id": sequence_id, "filename": "run.mcap", "state": "registered"}
            session.add(Recording(**facts, size_bytes=1, sha256="0" * 64))
    files = {camera_file("CAM_FRONT", token): b"\xff\xd8" + token.encode() + content for token in tokens}
    files |= {cloud_file(token): b"STC1" + token.encode() + content for token in tokens}
    sensors = (PlacedSensor("LIDAR_TOP", "lidar", (0.0, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0)),)
    files |= {radar_file(token): b"STE1" + token.encode() + content for token in tokens}
    files |= {
        CAMERAS: b"STR1" + content,
        INDEX: index_record(PlaybackChannels(("CAM_FRONT",), True, True, sensors, True)),
    }
    return export(platform, sequence_id, files, PLAYBACK)


def scene_json(name: str, tokens: Listing[str]) -> bytes:
    """Return the labeler's description for the viewer of a sequence with these frames."""
    frames = {
        "tokens": list(tokens),
        "stamps_ns": [str(stamp_of(i)) for i in range(len(tokens))],
        "map_from_ego": [[float(i), 0.0, 0.3, 1.0, 0.0, 0.0, 0.0] for i in range(len(tokens))],
    }
    record = {
        "name": name,
        "profile": "paper",
        "grid": {"shape": [256, 256, 32], "min_m": [-25.6, -25.6, -2.0], "voxel_m": 0.2},
        "footprint_m": [1.06, 0.85],
        "reference": {
            "mean": [0.0, 0.1, -9.0],
            "covariance": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            "d2_limit": 7.8147,
            "features": ["elevation_m", "slope_rad", "roughness"],
        },
        "frames": frames,
        "tiles": [{"name": "0_-1", "min_m": [0.0, -4.0, 0.0], "max_m": [4.0, 0.0, 2.0], "voxels": 9, "bytes": 4}],
        "meshes": [{"name": "0_-1", "triangles": 3, "bytes": 4}],
    }
    return json.dumps(record).encode()


def export(platform: Platform, sequence_id: str, files: Mapping[str, bytes], form: str = "mesh") -> str:
    """Create a finished export of the sequence's labels with these files, in packs of 2 KiB; return its id."""
    with platform.database.transaction() as session:
        row, job = start_export(session, session.get_one(SequenceRow, sequence_id), form)
    folder = Path(platform.settings.root) / f"made-{new_id()}"
    for name, content in files.items():
        (folder / "files" / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / "files" / name).write_bytes(content)
    packed = pack_folder(folder / "files", folder / "packs", lambda done, total: None, pack_bytes=2048)
    (folder / "index.npz").write_bytes(index_bytes(packed))
    paths = [folder / "index.npz", *sorted((folder / "packs").iterdir())]
    index, *packs = [blobs.prepare(platform.store, platform.database, path) for path in paths]
    tar, zipped = (
        archive_sha256(packed, kind, local_reader(folder / "packs"), lambda done, total: None) for kind in KINDS
    )
    with platform.database.transaction() as session:
        ended: Any = SimpleNamespace(job_id=job.id, sequence_id=sequence_id, arguments=job.arguments)
        write_export(session, ended, ExportResult(packed, index, packs, tar, zipped), 2**40)
        session.get_one(Job, job.id).state = "succeeded"
    return row.id


def label_comparison(platform: Platform, sequence_id: str, pair: tuple[str, str]) -> str:
    """Request a comparison of these label sets A and B; return its id."""
    with platform.database.transaction() as session:
        comparison, _ = start_comparison(session, session.get_one(SequenceRow, sequence_id), *pair)
        return comparison.id


def run(platform: Platform, owner: Person, *kinds: str, sequence_id: str | None = None) -> str:
    """Queue a run of jobs of these kinds, each after the previous; return its id."""
    keys = [str(number) for number in range(len(kinds))]
    specs = [
        JobSpec(kind, {}, key, tuple(keys[:i][-1:])) for i, (kind, key) in enumerate(zip(kinds, keys, strict=True))
    ]
    with platform.database.transaction() as session:
        return enqueue_run(session, "sequence.process", specs, Context(owner.user_id, sequence_id)).id


def job(platform: Platform, owner: Person, kind: str, **arguments: Any) -> str:
    """Queue a job that is its own run; return its id."""
    with platform.database.transaction() as session:
        return enqueue(session, JobSpec(kind, arguments), Context(owner.user_id)).id


def row_of(platform: Platform, job_id: str) -> Job:
    with platform.database.reading() as session:
        return session.get_one(Job, job_id)


def _context(made: Mapping[str, Any]) -> Context:
    return Context(made["owner_id"], made["id"])


def _artefact(session: Any, platform: Platform, label_set_id: str, name: str, content: bytes) -> str:
    path = Path(platform.settings.root) / f"made-{new_id()}"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    blob = blobs.keep(session, platform.store, path)
    media = {
        "parquet": "application/vnd.apache.parquet",
        "json": "application/json",
        "ply": "model/ply",
        "png": "image/png",
    }
    row = Artefact(label_set_id=label_set_id, name=name, blob_sha256=blob.sha256, size_bytes=len(content))
    row.media_type = media.get(name.rpartition(".")[2], "application/octet-stream")
    session.add(row)
    session.flush()
    return row.id
