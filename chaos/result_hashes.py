"""Hashes of everything that a run stored, to compare runs of the same inputs.

**Conventions.** Hashes are taken of what is read back, never copied from a row; where a row says another hash, or the
bytes are not there, that is a `Flaw`.
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
    """sha256 of every artefact by name, of every frame's labels by (ordinal, token), and how many jobs of each kind."""

    artefacts: Mapping[str, str] = field(default_factory=dict)
    frames: Mapping[tuple[int, str], str] = field(default_factory=dict)
    jobs: Mapping[str, int] = field(default_factory=dict)
    flaws: tuple[str, ...] = ()


@dataclass(frozen=True)
class OwnerRun:
    """What the owner of a round brought to the platform, and the run that was to be made of it.

    `replaced_id` is the run that an upgrade ended, and in whose place `run_id` was begun.
    """

    owner_id: str
    sequence_id: str
    run_id: str
    sha256: str
    size_bytes: int
    replaced_id: str = ""


def made_by(platform: Platform, brought: OwnerRun) -> RunArtefacts:
    """What lies in the store under the label sets of the run, and every job of its sequence but a replaced run's."""
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
    """The object, or None where there is none."""
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
        flaws.append(f"artefact {artefact.name} is not what its row says: {artefact.blob_sha256}")
    return content


def _frame_hash(row: LabelledFrameRow, pack: bytes, flaws: list[str]) -> str:
    found = sha256(pack[row.offset_bytes : row.offset_bytes + row.length_bytes]).hexdigest()
    if found != row.sha256:
        flaws.append(f"frame {row.ordinal} is not what its row says: {row.sha256}")
    return found
