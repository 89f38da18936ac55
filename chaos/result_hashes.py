"""Hashes of everything that a run stored, to compare runs of the same inputs.

**Conventions.** Hashes are computed from the stored bytes, never copied from a row. If a row has another hash, or the
bytes are missing, that is a flaw.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from hashlib import sha256

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.runtime.orm import Artefact, Blob, Job, LabelledFrameRow, LabelSet
from services.runtime.platform import Platform
from services.runtime.store.keys import ObjectMissingError
from services.runtime.store.protocol import Store


@dataclass(frozen=True)
class RunArtefacts:
    """The sha256 of artefacts by name and of frames' labels by (ordinal, token), and the jobs of each kind."""

    artefacts: Mapping[str, str] = field(default_factory=dict)
    frames: Mapping[tuple[int, str], str] = field(default_factory=dict)
    jobs: Mapping[str, int] = field(default_factory=dict)
    flaws: tuple[str, ...] = ()


@dataclass(frozen=True)
class OwnerRun:
    """A round's upload by its owner, and the run that processes it.

    `replaced_id` is a run ended by an upgrade and replaced by `run_id`.
    """

    owner_id: str
    sequence_id: str
    run_id: str
    sha256: str
    size_bytes: int
    replaced_id: str = ""


def made_by(platform: Platform, brought: OwnerRun) -> RunArtefacts:
    """Return the stored label sets of the run, and every job of its sequence except those of a replaced run."""
    counted = (Job.sequence_id == brought.sequence_id, Job.root_id != brought.replaced_id)
    with platform.database.reading() as session:
        kinds = session.scalars(select(Job.kind).where(*counted)).all()
        artefacts = _artefacts(session, brought.run_id)
        frames = _frames(session, brought.run_id)
    flaws: list[str] = []
    contents = {row.name: _content(platform.store, row, blob, flaws) for row, blob in artefacts}
    name_of = {row.id: row.name for row, _ in artefacts}
    packs = {row.pack_id: contents[name_of[row.pack_id]] for row in frames}
    return RunArtefacts(
        artefacts={name: sha256(content).hexdigest() for name, content in contents.items()},
        frames={(row.ordinal, row.token): _frame_hash(row, packs[row.pack_id], flaws) for row in frames},
        jobs=Counter(kinds),
        flaws=tuple(flaws),
    )


def object_bytes(store: Store, key: str) -> bytes | None:
    """Return the object's bytes, or None if there is no object."""
    try:
        return b"".join(store.read(key))
    except ObjectMissingError:
        return None


def _artefacts(session: Session, run_id: str) -> list[tuple[Artefact, Blob]]:
    statement = select(Artefact, Blob).join(Blob, Blob.sha256 == Artefact.blob_sha256)
    of_run = statement.join(LabelSet, LabelSet.id == Artefact.label_set_id).where(LabelSet.job_id == run_id)
    return [(artefact, blob) for artefact, blob in session.execute(of_run.order_by(Artefact.name))]


def _frames(session: Session, run_id: str) -> list[LabelledFrameRow]:
    of_run = select(LabelledFrameRow).join(LabelSet, LabelSet.id == LabelledFrameRow.label_set_id)
    return list(session.scalars(of_run.where(LabelSet.job_id == run_id).order_by(LabelledFrameRow.ordinal)))


def _content(store: Store, artefact: Artefact, blob: Blob, flaws: list[str]) -> bytes:
    content = object_bytes(store, blob.object_key)
    if content is None:
        flaws.append(f"artefact {artefact.name} has no object {blob.object_key}")
        return b""
    if sha256(content).hexdigest() != artefact.blob_sha256:
        flaws.append(f"artefact {artefact.name} differs from its row: {artefact.blob_sha256}")
    return content


def _frame_hash(row: LabelledFrameRow, pack: bytes, flaws: list[str]) -> str:
    digest = sha256(pack[row.offset_bytes : row.offset_bytes + row.length_bytes]).hexdigest()
    if digest != row.sha256:
        flaws.append(f"frame {row.ordinal} differs from its row: {row.sha256}")
    return digest
