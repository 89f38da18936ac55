"""How far an import is, scene by scene."""

from collections.abc import Mapping
from dataclasses import dataclass

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.domain.imports.requests import SCENE
from services.runtime.orm import DatasetImport, Job, SequenceRow


@dataclass(frozen=True)
class SceneProgress:
    """A scene and the job that imports it.

    `state` is the job's; `sequence_id` is the sequence with its labels once the whole import has ended well, unless
    that was deleted since.
    """

    ordinal: int
    name: str
    frames: int
    splits: tuple[str, ...]
    state: str
    sequence_id: str | None


@dataclass(frozen=True)
class ImportProgress:
    """An import, its run, and its scenes: none before the index was made."""

    imported: DatasetImport
    run: Job
    scenes: tuple[SceneProgress, ...]

    @property
    def done(self) -> int:
        """The number of scenes that are done."""
        return sum(scene.state == "succeeded" for scene in self.scenes)


def progress_of(session: Session, imported: DatasetImport) -> ImportProgress:
    """How far it is."""
    run, records = session.get_one(Job, imported.job_id), imported.scenes or []
    states = _states(session, run.id)
    ids = [record["sequence_id"] for record in records if "sequence_id" in record]
    alive = set(
        session.scalars(select(SequenceRow.id).where(SequenceRow.id.in_(ids), SequenceRow.deleted_ns.is_(None)))
    )
    scenes = (
        SceneProgress(
            ordinal,
            record["name"],
            record["frames"],
            tuple(record["splits"]),
            states.get(ordinal, "queued"),
            record.get("sequence_id") if record.get("sequence_id") in alive else None,
        )
        for ordinal, record in enumerate(records)
    )
    return ImportProgress(imported, run, tuple(scenes))


def _states(session: Session, root_id: str) -> Mapping[int, str]:
    jobs = select(Job.arguments, Job.state).where(Job.root_id == root_id, Job.kind == SCENE)
    return {arguments["scene"]: state for arguments, state in session.execute(jobs)}
