"""Inputs of a phase or a version as their job leaves them, without the recording they would be made of."""

from collections.abc import Callable, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from sqlalchemy.orm import Session

from services.domain.benchmarks.phases.inputs import write_input
from services.domain.datasets.input_jobs import InputResult, write_version_input
from services.runtime.jobs.specs import Attempt
from services.runtime.orm import new_id
from services.runtime.platform import Platform
from services.runtime.store import blobs
from services.runtime.store.pack_reading import archive_sha256, local_reader
from services.runtime.store.packs import index_bytes, pack_folder

Write = Callable[[Session, Attempt, InputResult], None]


def made_input(platform: Platform, phase_id: str, name: str, files: Mapping[str, bytes]) -> InputResult:
    """The input of a phase's sequence with these files; packs of 2 KiB."""
    return _written(platform, (write_input, {"phase_id": phase_id}), name, files)


def made_version_input(platform: Platform, dataset_id: str, name: str, files: Mapping[str, bytes]) -> InputResult:
    """The input of a version's sequence with these files; packs of 2 KiB."""
    return _written(platform, (write_version_input, {"dataset_id": dataset_id}), name, files)


def _written(
    platform: Platform, to: tuple[Write, Mapping[str, str]], name: str, files: Mapping[str, bytes]
) -> InputResult:
    folder = Path(platform.settings.root) / f"made-{new_id()}"
    for path, content in files.items():
        (folder / "files" / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / "files" / path).write_bytes(content)
    packed = pack_folder(folder / "files", folder / "packs", lambda done, total: None, pack_bytes=2048)
    (folder / "index.npz").write_bytes(index_bytes(packed))
    paths = [folder / "index.npz", *sorted((folder / "packs").iterdir())]
    index, *packs = [blobs.prepare(platform.store, platform.database, path) for path in paths]
    tar = archive_sha256(packed, "tar", local_reader(folder / "packs"), lambda done, total: None)
    made = InputResult(name, packed, index, packs, tar)
    write, arguments = to
    attempt: Any = SimpleNamespace(arguments=arguments)
    with platform.database.transaction() as session:
        write(session, attempt, made)
    return made
