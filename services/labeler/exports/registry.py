"""The export formats of labels, by name.

**Conventions.** An exporter writes one labelled sequence into an empty folder and calls `step(done, total)` to report
progress. Equal inputs give equal bytes. Memory does not grow with the number of frames. A format's module is imported
at its first use, since each needs its own library.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import cast

from services.labeler.exports.source import LabelledSequence
from services.labeler.run import Step
from stone.errors import Refused

Write = Callable[[LabelledSequence, Path, Step], None]


@dataclass(frozen=True)
class Exporter:
    """An exporter that is imported when called, and its inputs besides the sequence and its map.

    `entry_point` is its `module:function`.
    """

    entry_point: str
    reads_labels: bool = True
    reads_samples: bool = True

    def __call__(self, source: LabelledSequence, out: Path, step: Step) -> None:
        module, _, function = self.entry_point.partition(":")
        cast("Write", getattr(import_module(module), function))(source, out, step)


EXPORTERS: Mapping[str, Exporter] = {
    "nuscenes": Exporter("services.labeler.exports.nuscenes.layout:write_nuscenes"),
    "inputs": Exporter("services.labeler.exports.sandboxed_export:write_inputs", reads_labels=False),
    "kitti": Exporter("services.labeler.exports.kitti:write_kitti"),
    "mesh": Exporter("services.labeler.exports.meshes:write_meshes", reads_labels=False, reads_samples=False),
    "mcap": Exporter("services.labeler.exports.foxglove:write_foxglove"),
    "rrd": Exporter("services.labeler.exports.rerun:write_rerun"),
    "previews": Exporter("services.labeler.previews.preview_files:write_previews"),
    "playback": Exporter("services.labeler.exports.playback:write_playback", reads_labels=False),
}


def exporter_of(name: str) -> Exporter:
    """Return the exporter. Raises `unknown_format`."""
    if name not in EXPORTERS:
        raise Refused(
            "unknown_format", f"{name[:80]!r} is not an export format; the formats are {', '.join(EXPORTERS)}"
        )
    return EXPORTERS[name]
