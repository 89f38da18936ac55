"""An export as a local folder: it appears atomically, stays untouched if unchanged, and can receive further sequences.

**Conventions.** `export.json` contains the format and the recipe of each sequence; `checksums/<sequence>.sha256` lists
its files (for `sha256sum --check`). Files of unchanged sequences are hard-linked into the new folder, never rewritten.
Shared files (tables, class names) are written again from all sequences, in the order of names.
"""

import json
import os
import shutil
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from hashlib import file_digest
from pathlib import Path, PurePosixPath
from typing import Any

from services.labeler.exports.errors import damaged_labels
from services.labeler.exports.kitti import SEQUENCES, write_config
from services.labeler.exports.nuscenes.tables import (
    SPLITS,
    TABLES,
    VERSION,
    NuscenesTableWriter,
    lines_of,
    write_splits,
)
from services.labeler.exports.registry import exporter_of
from services.labeler.exports.source import LabelledSequence
from services.labeler.run import Step
from services.runtime.store.recipes import recipe_of
from stone.errors import Refused
from stone.sensors.sequence import NAME
from stone_base.label_quality import quality_of
from stone_files.atomic import atomic_directory

MANIFEST, CHECKSUMS, FRESH = "export.json", "checksums", ".fresh"
# The parts of a report that determine an export's bytes; seconds and memory do not. `SENSED` needs no labels.
SENSED = ("sequence", "inputs", "parameters", "code_version", "frames")
DECIDING = (*SENSED, "class_share_of_occupied", "reference", "map", "held_out", "findings")


@dataclass(frozen=True)
class ExportFolderEntry:
    """A sequence of an export; `number` is its index in formats that number sequences.

    `quality` is that of its labels, None in an export without labels or of an earlier version.
    """

    recipe: str
    frames: int
    number: int
    quality: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class ExportOutcome:
    """The result of an export: `status` is written, added (beside other sequences), replaced or unchanged."""

    format: str
    sequence: str
    status: str
    frames: int
    sequences: tuple[str, ...]
    files: int = 0
    size_bytes: int = 0


@dataclass(frozen=True)
class ExportRequest:
    """The format's name, the folder, and the report of the labels."""

    format: str
    out: Path
    report: Mapping[str, Any]


def export(request: ExportRequest, open_source: Callable[[], LabelledSequence], step: Step) -> ExportOutcome:
    """Export a sequence into the folder, which may contain other sequences; the source is opened only if needed.

    Raises `unknown_format`, `not_an_export`, `damaged_labels`, `export_clash`, `output_exists`, and what opening and
    exporting raise.
    """
    exporter, (name, frames) = exporter_of(request.format), _describe_report(request.report)
    known = read_manifest(request.out, request.format)
    recipe = recipe_of(
        "exports", {"format": request.format} | {key: request.report.get(key) for key in _deciding(request.format)}
    )
    if name in known and known[name].recipe == recipe:
        return ExportOutcome(request.format, name, "unchanged", known[name].frames, tuple(sorted(known)))
    quality = None if request.format == "inputs" else quality_of(request.report).as_record()
    entry = ExportFolderEntry(recipe, frames, _number(known, name), quality)
    entries = {**known, name: entry}
    with atomic_directory(request.out, replaces=MANIFEST) as staging:
        fresh = staging / FRESH
        fresh.mkdir()
        exporter(_opened(open_source, name), fresh, step)
        rearrange(request.format, fresh, name, entry.number)
        for other in sorted(set(known) - {name}):
            _link_kept(request.out, staging, other)
        files, size_bytes = _move_in(fresh, staging, name)
        fresh.rmdir()
        join(request.format, staging, {sequence: entries[sequence].number for sequence in sorted(entries)})
        (staging / MANIFEST).write_text(_manifest(request.format, entries), "utf-8")
    status = "replaced" if name in known else "added" if known else "written"
    return ExportOutcome(request.format, name, status, entry.frames, tuple(sorted(entries)), files, size_bytes)


def _deciding(format_name: str) -> tuple[str, ...]:
    return SENSED if format_name == "inputs" else DECIDING


def _describe_report(report: Mapping[str, Any]) -> tuple[str, int]:
    """Return the sequence name and the number of frames in a report."""
    name, frames = report.get("sequence"), report.get("frames")
    if not isinstance(name, str) or not NAME.fullmatch(name) or not isinstance(frames, int):
        raise damaged_labels(Path("report.json"), "it contains no sequence name or no number of frames")
    return name, frames


def _opened(open_source: Callable[[], LabelledSequence], name: str) -> LabelledSequence:
    source = open_source()
    if source.sequence.name != name:
        raise damaged_labels(
            Path("sequence.npz"), f"it describes sequence {source.sequence.name}, but the report describes {name}"
        )
    return source


def read_manifest(out: Path, format_name: str) -> dict[str, ExportFolderEntry]:
    """Return the sequences in a folder by name; empty if it contains no export. Raises `not_an_export`."""
    path = out / MANIFEST
    if not path.exists():
        return {}
    try:
        content = json.loads(path.read_text("utf-8"))
        entries = {str(name): ExportFolderEntry(**entry) for name, entry in content["sequences"].items()}
        written_format = str(content["format"])
        is_ours = all(NAME.fullmatch(name) and isinstance(entry.number, int) for name, entry in entries.items())
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise not_an_export(out, f"{MANIFEST} cannot be read ({error})"[:200]) from error
    if not is_ours:
        raise not_an_export(out, f"{MANIFEST} cannot be read (a sequence has an invalid name or no number)")
    if written_format != format_name:
        raise not_an_export(out, f"it contains an export in format {written_format}, not {format_name}")
    return entries


def _number(known: Mapping[str, ExportFolderEntry], name: str) -> int:
    """Return the sequence's own number, or the smallest free one."""
    if name in known:
        return known[name].number
    taken = {entry.number for entry in known.values()}
    return next(number for number in range(len(taken) + 1) if number not in taken)


def _manifest(format_name: str, entries: Mapping[str, ExportFolderEntry]) -> str:
    sequences = {name: asdict(entries[name]) for name in sorted(entries)}
    return json.dumps({"format": format_name, "sequences": sequences}, indent=1) + "\n"


def _move_in(fresh: Path, staging: Path, name: str) -> tuple[int, int]:
    """Move the new files to their final paths and write their checksums; return their number and bytes."""
    lines, size_bytes = [], 0
    for path in sorted(path for path in fresh.rglob("*") if path.is_file()):
        relative = path.relative_to(fresh)
        if (staging / relative).exists():
            raise Refused(
                "export_clash",
                f"{relative.as_posix()[:200]} of sequence {name} already belongs to another sequence in this export; "
                "was one recording labelled under two names?",
            )
        (staging / relative).parent.mkdir(parents=True, exist_ok=True)
        with path.open("rb") as file:
            lines.append(f"{file_digest(file, 'sha256').hexdigest()}  {relative.as_posix()}\n")
        size_bytes += path.stat().st_size
        path.rename(staging / relative)
    for folder in sorted((path for path in fresh.rglob("*")), reverse=True):
        folder.rmdir()
    (staging / CHECKSUMS).mkdir(exist_ok=True)
    (staging / CHECKSUMS / f"{name}.sha256").write_text("".join(lines), "utf-8")
    return len(lines), size_bytes


def _link_kept(out: Path, staging: Path, name: str) -> None:
    """Link an unchanged sequence's files into the new folder; copy only if the filesystem has no hard links."""
    listing = f"{CHECKSUMS}/{name}.sha256"
    try:
        files = [line[66:] for line in (out / listing).read_text("utf-8").splitlines()]
    except (OSError, ValueError) as error:
        raise not_an_export(out, f"{listing} cannot be read ({error})"[:200]) from error
    for relative in (*files, listing):
        if PurePosixPath(relative).is_absolute() or ".." in PurePosixPath(relative).parts:
            raise not_an_export(out, f"{listing} lists a path outside the export: {relative[:80]!r}")
        if not (out / relative).is_file():
            raise not_an_export(out, f"{relative[:120]} of sequence {name} is missing")
        (staging / relative).parent.mkdir(parents=True, exist_ok=True)
        _link(out / relative, staging / relative)


def _link(old: Path, new: Path) -> None:
    try:
        os.link(old, new, follow_symlinks=False)
    except FileExistsError:
        raise
    except OSError:  # a filesystem without hard links
        shutil.copy2(old, new)


# Shared files of an export folder, merged from its sequences. In nuScenes folders, with or without labels, each
# sequence's tables are in `tables/<sequence>/`. The tables in `v1.0-trainval/` concatenate them, with common rows (a
# sensor, a class) once. In SemanticKITTI, a sequence is a number. Other formats share nothing. The result does not
# depend on the order in which nuScenes sequences were added.


OWN_TABLES = "tables"
TABLED = ("nuscenes", "inputs")
SHARED_TABLES = frozenset({"attribute", "category", "sensor", "visibility"})


def rearrange(format_name: str, fresh: Path, sequence: str, number: int) -> None:
    """Move an exporter's files for one sequence to paths that do not collide with other sequences."""
    if format_name in TABLED:
        (fresh / OWN_TABLES).mkdir()
        (fresh / VERSION).rename(fresh / OWN_TABLES / sequence)
        (fresh / OWN_TABLES / sequence / SPLITS).unlink()
    if format_name == "kitti":
        (fresh / SEQUENCES / "00").rename(fresh / SEQUENCES / f"{number:02d}")
        for config in fresh.glob("*.yaml"):
            config.unlink()


def join(format_name: str, folder: Path, numbers: Mapping[str, int]) -> None:
    """Write the shared files of these sequences (name → number)."""
    if format_name in TABLED:
        (folder / VERSION).mkdir()
        for table in TABLES:
            _join_table(folder, table, numbers)
        write_splits(folder / VERSION / SPLITS, {"all": sorted(numbers)})
    if format_name == "kitti":
        write_config(folder, numbers)


def _join_table(folder: Path, table: str, numbers: Mapping[str, int]) -> None:
    seen = set[str]()
    with (folder / VERSION / f"{table}.json").open("w", encoding="utf-8") as file:
        rows = NuscenesTableWriter(file)
        for sequence in sorted(numbers):
            for line in lines_of(folder / OWN_TABLES / sequence / f"{table}.json"):
                if table in SHARED_TABLES and (token := json.loads(line)["token"]) in seen:
                    continue
                if table in SHARED_TABLES:
                    seen.add(token)
                rows.add(line)
        rows.end()


def not_an_export(out: Path, reason: str) -> Refused:
    return Refused(
        "not_an_export", f"{out} cannot receive this export: {reason}; choose another --output, or remove the folder"
    )
