"""The playback of a label set: small pictures, thinned sweeps and radar detections for the viewer.

    playback.json   cameras.bin   cameras/<CHANNEL>/<frame_token>.jpg   clouds/<frame_token>.bin
    radars/<frame_token>.bin

**Conventions.** An export with its own format, made after labels are published; its files are served one by one to
viewers of the sequence. `playback.json` is {"cameras": [channel, ...], "has_clouds": bool, "has_rays": bool, "sensors":
[{"channel", "kind", "ego_from_sensor"}, ...], "has_radars": bool}. `cameras.bin` (`STR1`) exists if `has_rays` is true.
Playbacks of earlier releases lack `has_rays`, `sensors` and `has_radars`.
"""

import json
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any, Literal

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.runtime.jobs.specs import TERMINAL
from services.runtime.orm import Export, Job
from services.runtime.store.pack_reading import ExportLocation, file_pieces, locate_export, stored_files
from services.runtime.store.protocol import Store

PLAYBACK, INDEX, CAMERAS = "playback", "playback.json", "cameras.bin"
HELD = 64
State = Literal["none", "making", "ready"]


@dataclass(frozen=True)
class Playback:
    """The state of a label set's playback; `located` gives its files once it is ready."""

    export_id: str | None
    state: State
    located: ExportLocation | None = None


@dataclass(frozen=True)
class PlacedSensor:
    """A sensor of the rig and its pose `ego_from_sensor`, tx ty tz qw qx qy qz."""

    channel: str
    kind: str
    ego_from_sensor: tuple[float, ...]


@dataclass(frozen=True)
class PlaybackChannels:
    """The channels of a playback in the order of the rig, its content besides pictures, and all sensors of the rig."""

    cameras: tuple[str, ...] = ()
    has_clouds: bool = False
    has_rays: bool = False
    sensors: tuple[PlacedSensor, ...] = ()
    has_radars: bool = False

    def as_record(self) -> dict[str, Any]:
        """Return the content of `playback.json`, and of a scene's `playback`."""
        return asdict(self)


def camera_file(channel: str, token: str) -> str:
    """Return the file name of a picture."""
    return f"cameras/{channel}/{token}.jpg"


def cloud_file(token: str) -> str:
    """Return the file name of a sweep."""
    return f"clouds/{token}.bin"


def radar_file(token: str) -> str:
    """Return the file name of a frame's radar detections."""
    return f"radars/{token}.bin"


def playback_of(session: Session, label_set_id: str) -> Playback:
    """Return the ready playback, or else the most recently requested one."""
    of_labels = select(Export).where(Export.label_set_id == label_set_id, Export.format == PLAYBACK)
    export = session.scalars(of_labels.order_by(Export.finished_ns.is_(None), Export.id.desc()).limit(1)).one_or_none()
    if export is None:
        return Playback(None, "none")
    if export.finished_ns is not None:
        return Playback(export.id, "ready", locate_export(session, export))
    is_over = session.get_one(Job, export.job_id).state in TERMINAL
    return Playback(export.id, "none" if is_over else "making")


def shown_by(store: Store, playback: Playback) -> PlaybackChannels:
    """Return the channels of a playback. Reads the store: call it outside transactions."""
    return PlaybackChannels() if playback.located is None else _shown(store, playback.located)


@lru_cache(maxsize=HELD)
def _shown(store: Store, located: ExportLocation) -> PlaybackChannels:
    """Return the cached channels; an export never changes."""
    stored = stored_files(store, located)
    ordinal = stored.files.ordinals[INDEX]
    span = (0, int(stored.files.sizes_bytes[ordinal]))
    record = json.loads(b"".join(file_pieces(stored.files, ordinal, span, stored.reader(store))))
    sensors = tuple(
        PlacedSensor(sensor["channel"], sensor["kind"], tuple(sensor["ego_from_sensor"]))
        for sensor in record.get("sensors", [])
    )
    has_rays = bool(record.get("has_rays", False))
    has_radars = bool(record.get("has_radars", False))
    return PlaybackChannels(tuple(record["cameras"]), bool(record["has_clouds"]), has_rays, sensors, has_radars)


def index_record(shown: PlaybackChannels) -> bytes:
    """Return the content of `playback.json`."""
    return json.dumps(shown.as_record()).encode()
