"""The source of an imported label set: the files of its scene in the release's layout, without labels, in packs.

    source/index.npz   source/000000.pack …

**Conventions.** A `PackedFiles` in the order of names: `v1.0-trainval/<table>.json`, `v1.0-trainval/splits.json`,
`samples/…`, `sweeps/…`, `maps/…`. Bytes are those of the dataset; files of sensors are checked before they are copied.
"""

from collections.abc import Callable
from pathlib import Path

from services.domain.sequences.label_sources import SOURCE, SOURCE_INDEX
from services.labeler.exports.nuscenes.tables import VERSION
from services.labeler.imports.errors import SceneDamagedError
from services.labeler.imports.scene_parts import TABLES, SceneParts
from services.runtime.store.packs import PackWriter, index_bytes, pieces_of
from stone_datasets.faults import DatasetPlace
from stone_datasets.samples import check_sample
from stone_exports.files import ExportFileSpan
from stone_exports.frames import LIDAR_CHANNEL, ExportedSensor
from stone_files.dataset_layout import ANNOTATIONS
from stone_files.virtual_archive import check_names

Told = Callable[[int, int], None]


def write_source(parts: SceneParts, out: Path, told: Told) -> None:
    """The index and the packs below `out`. Raises a `DatasetFaultError`, `BadMemberError`, `StoreFullError`."""
    tables = {f"{VERSION}/{path.name}": path for path in (parts.folder / TABLES).iterdir()}
    places = {name: number for number, name in enumerate(parts.spans.names)}
    names = sorted({*tables, *places})
    check_names(names)
    sensors, packed = sensors_of(parts), PackWriter(out / SOURCE)
    for done, name in enumerate(names):
        told(done, len(names))
        if name in tables:
            packed.add(name, pieces_of(tables[name]))
        else:
            packed.add(name, _checked(parts, places[name], sensors).pieces())
    (out / SOURCE_INDEX).write_bytes(index_bytes(packed.files()))


def sensors_of(parts: SceneParts) -> dict[str, ExportedSensor]:
    """The sensors of the scene by channel, as its files are checked against them."""
    calibration = parts.sequence.calibration
    lidar = ExportedSensor(LIDAR_CHANNEL, "lidar", calibration.ego_from_lidar, None)
    return {LIDAR_CHANNEL: lidar} | {
        mount.name: ExportedSensor(mount.name, mount.kind, mount.lidar_from_sensor, mount.intrinsics)
        for mount in calibration.mounts
    }


def _checked(parts: SceneParts, number: int, sensors: dict[str, ExportedSensor]) -> ExportFileSpan:
    """The span of a file, which is what its sensor gives; of a map nothing is asked."""
    spans = parts.spans
    span = ExportFileSpan(parts.tar, spans.names[number], *spans.places[number].tolist())
    channel, row = spans.channels[number], int(spans.rows[number])
    if not channel:
        return span
    if channel not in sensors:
        raise SceneDamagedError(f"{span.name} is of {channel!r}, which the rig does not have")
    table = ANNOTATIONS if row < 0 else f"{parts.version}/sample_data.json"
    check_sample(span, sensors[channel], DatasetPlace(table, None if row < 0 else row + 1))
    return span
