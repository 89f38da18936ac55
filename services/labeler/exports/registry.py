"""The formats that labels are exported in, by name.

**Conventions.** An exporter writes one labelled sequence into an empty folder and calls `step(done, total)` as it goes
on. Equal inputs give equal bytes. Memory does not grow with the number of frames. A format's module is loaded when it
is used: each brings a library of its own.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import cast

from services.labeler.exports.errors import UnknownFormatError
from services.labeler.exports.source import LabelledSequence
from services.labeler.run import Step

Exporter = Callable[[LabelledSequence, Path, Step], None]


@dataclass(frozen=True)
class _Late:
    """An exporter that is imported when it is called."""

    module: str
    function: str

    def __call__(self, source: LabelledSequence, out: Path, step: Step) -> None:
        cast("Exporter", getattr(import_module(f"services.labeler.{self.module}"), self.function))(source, out, step)


EXPORTERS: Mapping[str, Exporter] = {
    "nuscenes": _Late("exports.nuscenes.layout", "write_nuscenes"),
    "inputs": _Late("exports.inputs", "write_inputs"),
    "kitti": _Late("exports.kitti", "write_kitti"),
    "mesh": _Late("exports.meshes", "write_meshes"),
    "mcap": _Late("exports.foxglove", "write_foxglove"),
    "rrd": _Late("exports.rerun", "write_rerun"),
    "previews": _Late("previews.preview_files", "write_previews"),
    "playback": _Late("exports.playback", "write_playback"),
}


def exporter_of(name: str) -> Exporter:
    """Raises `UnknownFormatError`."""
    if name not in EXPORTERS:
        raise UnknownFormatError(name, EXPORTERS)
    return EXPORTERS[name]
