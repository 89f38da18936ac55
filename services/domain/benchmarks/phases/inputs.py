"""Phase inputs: the sensor data of a phase's sequences, made by jobs and served for download.

**Conventions.** An input is made once per sequence and phase (`services/domain/datasets/input_jobs.py`) and never
changes. Foreign keys to blobs hold its bytes, so the input outlives the sequence. Adding an input to a phase locks the
phase's row.
"""

from sqlalchemy import Select, select
from sqlalchemy.orm import Session

from services.domain.benchmarks.phases.phases import lock_phase
from services.domain.datasets.input_jobs import (
    InputResult,
    add_input,
    input_spec,
    inputs_complete,
    inputs_impossible,
    is_possible,
    members_of,
    run_under_way,
)
from services.runtime.jobs.enqueue import enqueue_run
from services.runtime.jobs.errors import JobCancelledError
from services.runtime.jobs.specs import Attempt, Context
from services.runtime.orm import Blob, Job, Phase, PhaseInput, PhaseInputPack
from services.runtime.store.pack_reading import ExportLocation

RUN = "phase.inputs"


def start_inputs(session: Session, phase: Phase, user_id: str) -> Job:
    """Return the run that makes the missing inputs: the current one, or a new one with a job for each sequence.

    Raises `inputs_complete`, `inputs_impossible`, `QueueDrainingError`.
    """
    phase = lock_phase(session, phase.id)
    holder = {"phase_id": phase.id}
    if run := run_under_way(session, RUN, holder):
        return run
    members = session.scalars(members_of(phase.dataset_id, [phase.part])).all()
    there = set(session.scalars(select(PhaseInput.name).where(PhaseInput.phase_id == phase.id)))
    missing = [member for member in members if member.name not in there]
    if not missing:
        raise inputs_complete(f"phase {phase.name!r}", len(members))
    if lost := [member.name for member in missing if not is_possible(session, member)]:
        raise inputs_impossible(lost)
    run = enqueue_run(session, RUN, [input_spec(holder, member) for member in missing], Context(user_id))
    run.arguments = holder
    return run


def write_input(session: Session, attempt: Attempt, made: InputResult) -> None:
    """Write a job's result in the transaction of its success; an existing input stays.

    Raises `JobCancelledError` if the phase was deleted.
    """
    phase = phase_of_attempt(session, attempt)
    add_input(session, made, (PhaseInput, PhaseInputPack), {"phase_id": phase.id})


def phase_of_attempt(session: Session, attempt: Attempt) -> Phase:
    """Return the attempt's phase with its row locked. Raises `JobCancelledError` if the phase was deleted."""
    wanted = select(Phase).where(Phase.id == attempt.arguments["phase_id"]).with_for_update(key_share=True)
    phase = session.scalars(wanted).one_or_none()
    if phase is None:
        raise JobCancelledError("its phase was deleted")
    return phase


def inputs_of(phase_id: str) -> Select[PhaseInput]:
    return select(PhaseInput).where(PhaseInput.phase_id == phase_id)


def locate_input(session: Session, row: PhaseInput) -> ExportLocation:
    """Return the locations of an input's files."""
    packs = select(Blob.object_key).join(PhaseInputPack, PhaseInputPack.blob_sha256 == Blob.sha256)
    own = packs.where(PhaseInputPack.phase_id == row.phase_id, PhaseInputPack.name == row.name)
    index = session.get_one(Blob, row.index_sha256)
    return ExportLocation(index.object_key, tuple(session.scalars(own.order_by(PhaseInputPack.ordinal))))
