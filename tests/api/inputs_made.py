"""Inputs of a phase as their job leaves them, without the recording they would be made of."""

from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from services.domain.benchmarks.phases.inputs import PhaseInputResult, write_input
from services.runtime.orm import new_id
from services.runtime.platform import Platform
from services.runtime.store import blobs
from services.runtime.store.pack_reading import archive_sha256, local_reader
from services.runtime.store.packs import index_bytes, pack_folder


def made_input(platform: Platform, phase_id: str, name: str, files: Mapping[str, bytes]) -> PhaseInputResult:
    """The input of a sequence with these files; packs of 2 KiB."""
    folder = Path(platform.settings.root) / f"made-{new_id()}"
    for path, content in files.items():
        (folder / "files" / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / "files" / path).write_bytes(content)
    packed = pack_folder(folder / "files", folder / "packs", lambda done, total: None, pack_bytes=2048)
    (folder / "index.npz").write_bytes(index_bytes(packed))
    paths = [folder / "index.npz", *sorted((folder / "packs").iterdir())]
    index, *packs = [blobs.prepare(platform.store, platform.database, path) for path in paths]
    tar = archive_sha256(packed, "tar", local_reader(folder / "packs"), lambda done, total: None)
    made = PhaseInputResult(name, packed, index, packs, tar)
    attempt: Any = SimpleNamespace(arguments={"phase_id": phase_id})
    with platform.database.transaction() as session:
        write_input(session, attempt, made)
    return made
