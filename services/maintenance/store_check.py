"""Checks whether the store contains the objects in the database, `python -m services.maintenance.store_check`: see
docs/operations/lost-objects.md.

**Conventions.** Prints a line of JSON on stdout for each damaged or missing object, and messages on stderr. The exit
code is 0 if nothing is lost (any more), 1 if an object is lost or the store is unavailable.
"""

import argparse
import hashlib
import json
import os
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

from sqlalchemy import Select, delete, exists, select
from sqlalchemy.orm import Session

import services.runtime.processes.sound_settings  # noqa: F401
from services.domain.sequences.processing import lock_sequence
from services.runtime.access import storage_quota
from services.runtime.orm import Artefact, Blob, Export, ExportPack, LabelSet
from services.runtime.platform import Platform, open_platform
from services.runtime.settings import Settings
from services.runtime.store.faults import fault_of, forget, tables_naming
from stone.errors import StoneError

# Repair of the store: finds damaged or missing objects, restores them from files, or deletes label sets and exports
# that need them, so that they can be made again. `sha256` and `size_bytes` in a blob's row define its object. Finding
# changes nothing and may run at any time. Restored files are recognised by content, never by name. Processing a
# recording again gives the same bits, so versions and scores that refer to the content are repaired too.


AT_A_TIME = 500
ASKED_AT_ONCE = 8


@dataclass(frozen=True)
class DamagedBlob:
    """A blob whose object is `missing`, has another `size` or other `bytes`; `named_by` are tables that need it."""

    sha256: str
    object_key: str
    size_bytes: int
    fault: str
    named_by: tuple[str, ...]


def damaged_blobs(platform: Platform, *, is_read: bool = False) -> Iterator[DamagedBlob]:
    """Yield every blob whose object differs from its row; with `is_read` all bytes are read and compared."""
    after = ""
    with ThreadPoolExecutor(ASKED_AT_ONCE) as pool:
        while blobs := _blobs_after(platform, after):
            after = blobs[-1].sha256
            faults = pool.map(lambda blob: fault_of(platform.store, blob, is_read=is_read), blobs)
            for blob, fault in zip(blobs, list(faults), strict=True):
                if fault:
                    yield from _still_named(platform, blob, fault)


def restore_objects(platform: Platform, lost: Sequence[DamagedBlob], folder: Path) -> list[DamagedBlob]:
    """Store files of the folder that match a lost object; return the restored blobs. Raises `StoreFullError`."""
    missing = {blob.sha256: blob for blob in lost}
    back = []
    for path in _files(folder, {blob.size_bytes for blob in lost}):
        with path.open("rb") as file:
            blob = missing.pop(hashlib.file_digest(file, "sha256").hexdigest(), None)
        if blob is not None:
            platform.store.write(blob.object_key, path)
            back.append(blob)
    with platform.database.transaction() as session:
        forget(session, [blob.sha256 for blob in back])
    return back


def forget_derived(platform: Platform, lost: Sequence[DamagedBlob]) -> int:
    """Delete label sets and exports with lost objects; return their number. They are made again on request.

    The exports of a label set are deleted with it. Recordings, versions, phases and submissions stay.
    """
    gone = {blob.sha256 for blob in lost}
    forgotten = 0
    for sequence_id in _sequences_with(platform, gone):
        with platform.database.transaction() as session:
            forgotten += _forget(session, lock_sequence(session, sequence_id).id, gone)
    return forgotten


def _forget(session: Session, sequence_id: str, gone: set[str]) -> int:
    label_sets = set(session.scalars(_labels_with(gone).where(LabelSet.sequence_id == sequence_id)))
    packed = select(ExportPack.export_id).where(ExportPack.blob_sha256.in_(gone))
    doomed = (Export.label_set_id.in_(label_sets)) | Export.index_sha256.in_(gone) | Export.id.in_(packed)
    exports = session.scalars(select(Export.id).where(Export.sequence_id == sequence_id, doomed)).all()
    for export_id in exports:
        storage_quota.release(session, export_id, "its bytes were lost")
    session.execute(delete(Export).where(Export.id.in_(exports)))
    session.execute(delete(LabelSet).where(LabelSet.id.in_(label_sets)))
    return len(exports) + len(label_sets)


def _labels_with(gone: set[str]) -> Select[str]:
    return select(LabelSet.id).where(
        exists().where(Artefact.label_set_id == LabelSet.id, Artefact.blob_sha256.in_(gone))
    )


def _sequences_with(platform: Platform, gone: set[str]) -> list[str]:
    """Return the sequences whose label sets or exports have lost objects."""
    with platform.database.reading() as session:
        labelled = select(LabelSet.sequence_id).where(LabelSet.id.in_(_labels_with(gone)))
        packed = select(ExportPack.export_id).where(ExportPack.blob_sha256.in_(gone))
        exported = select(Export.sequence_id).where(Export.index_sha256.in_(gone) | Export.id.in_(packed))
        return sorted({*session.scalars(labelled), *session.scalars(exported)})


def _blobs_after(platform: Platform, after: str) -> Sequence[Blob]:
    with platform.database.reading() as session:
        some = select(Blob).where(Blob.sha256 > after).order_by(Blob.sha256).limit(AT_A_TIME)
        return session.scalars(some).all()


def _still_named(platform: Platform, blob: Blob, fault: str) -> Iterator[DamagedBlob]:
    """Yield the damaged blob, unless garbage collection deleted it meanwhile."""
    with platform.database.reading() as session:
        if session.scalar(select(Blob.object_key).where(Blob.sha256 == blob.sha256)) != blob.object_key:
            return
        yield DamagedBlob(
            blob.sha256, blob.object_key, blob.size_bytes, fault, tuple(tables_naming(session, blob.sha256))
        )


def _files(folder: Path, sizes: set[int]) -> Iterator[Path]:
    """Yield regular files of one of these sizes; links are not followed."""
    for above, _, names in os.walk(folder):
        for name in sorted(names):
            path = Path(above) / name
            if not path.is_symlink() and path.is_file() and path.stat().st_size in sizes:
                yield path


# isort: split


def main(arguments: list[str] | None = None) -> int:
    options = _options(arguments)
    platform = open_platform(Settings())
    try:
        return len(_check_and_repair(platform, options)) and 1
    except StoneError as error:
        _say(f"{error.code}: {error}")
        return 1
    finally:
        platform.database.close()


def _check_and_repair(platform: Platform, options: argparse.Namespace) -> list[DamagedBlob]:
    """Check and repair as requested; return the objects that are still lost."""
    lost = []
    for blob in damaged_blobs(platform, is_read=options.bytes):
        sys.stdout.write(json.dumps(asdict(blob)) + "\n")
        lost.append(blob)
    _say(f"{len(lost)} objects are lost")
    for folder in options.sources:
        back = restore_objects(platform, lost, folder)
        lost = [blob for blob in lost if blob not in back]
        _say(f"{len(back)} objects were restored from {folder}; {len(lost)} are lost")
    if options.forget and lost:
        _say(f"{forget_derived(platform, lost)} label sets and exports were deleted; request them again")
    return lost


def _say(sentence: str) -> None:
    sys.stderr.write(sentence + "\n")


def _options(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m services.maintenance.store_check", description=__doc__)
    parser.add_argument("--bytes", action="store_true", help="Read every object and compare its sha256")
    parser.add_argument(
        "--from",
        action="append",
        default=[],
        type=Path,
        dest="sources",
        metavar="FOLDER",
        help="Restore lost objects from the files of this folder",
    )
    parser.add_argument(
        "--forget", action="store_true", help="Delete damaged label sets and exports, so that they can be made again"
    )
    return parser.parse_args(arguments)


if __name__ == "__main__":
    sys.exit(main())
