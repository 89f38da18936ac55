"""The generated rows: sequences, owners, boards, jobs and their history.

**Conventions.** A fifth of the sequences belongs to owner 1, five to owner 2, the rest to the others; the run, labels
and files of the n-th sequence have its number. Person 0 is the administrator.
"""

from dataclasses import dataclass

from sqlalchemy import Connection, text

from benchmarks.rows.boards import insert_boards, insert_dataset
from benchmarks.rows.bulk_inserts import insert_rows, numbers, without_indexes
from services.runtime.orm.base import now_ns

OWNERS, TEAMS, PHASES, WORKERS = 1000, 1000, 20, 1000
USER, SEQUENCE, JOB, UPLOAD, RECORDING, LABELS, ARTEFACT, EXPORT, PREVIEW, TEAM, OTHER = range(1, 12)
NOW_NS = now_ns()
AGO = f"{NOW_NS} - (:most - n) * 1000000000"  # row n of :most came a second after row n − 1
BIG = ("sequences", "jobs", "blobs", "artefacts", "labelled_frames", "recordings", "recording_files", "uploads",
       "label_sets", "quota_ledger", "audit_log", "exports", "previews", "job_attempts")  # fmt: skip


@dataclass(frozen=True)
class Amounts:
    """Numbers of rows by kind; per sequence: jobs of its run, artefacts of its labels, rows of labelled frames."""

    sequences: int = 1_000_000
    submissions: int = 100_000
    jobs_each: int = 3
    artefacts_each: int = 4
    frames_each: int = 4
    backlog: int = 20_000
    members: int = 100_000


def fill(connection: Connection, amounts: Amounts) -> None:
    """Insert all rows, each table in one statement."""
    _people(connection)
    with without_indexes(connection, BIG):
        _sequences(connection, amounts)
        _jobs(connection, amounts)
        _made(connection, amounts)
        _ledgers(connection, amounts)
    insert_dataset(connection, amounts.members)
    insert_boards(connection, amounts.submissions, (amounts.sequences, amounts.jobs_each + 1))
    connection.execute(text("SET session_replication_role = origin"))


def owner(count: int) -> str:
    others = f"hex_id({USER}, (n * n) % {OWNERS})"
    modest = f"n % {max(count // 5, 1)} = 3"
    return f"CASE WHEN {modest} THEN hex_id({USER}, 2) WHEN n % 5 = 0 THEN hex_id({USER}, 1) ELSE {others} END"


def _aged(most: int) -> str:
    return AGO.replace(":most", str(most))


def _people(connection: Connection) -> None:
    people = f"generate_series(0::bigint, {OWNERS}) AS n"
    role = "CASE WHEN n = 0 THEN 'administrator' ELSE 'curator' END"
    insert_rows(connection, "users", people, {"id": f"hex_id({USER}, n)", "name": "'person-' || n", "role": role})
    insert_rows(connection, "teams", numbers(TEAMS), {"id": f"hex_id({TEAM}, n)", "name": "'team-' || n"})
    member = {"team_id": f"hex_id({TEAM}, n)", "user_id": f"hex_id({USER}, n)", "is_owner": "true"}
    insert_rows(connection, "team_members", numbers(TEAMS), member)
    beat = {"name": "'worker-' || n / 8 || ':' || n", "queues": "'eval,ingest,labeler'", "beat_ns": str(NOW_NS)}
    insert_rows(connection, "workers", numbers(WORKERS), beat)
    insert_rows(
        connection, "loose_objects", numbers(1000), {"object_key": "'blobs/loose/' || n", "expected_ns": str(NOW_NS)}
    )


def _sequences(connection: Connection, amounts: Amounts) -> None:
    count = amounts.sequences
    words = {
        "environment": "(ARRAY['forest','field','urban','desert','hills','snow'])[1 + n % 6]",
        "illumination": "(ARRAY['day','dusk','night','rain'])[1 + n % 4]",
        "region": f"CASE WHEN n % {max(count // 20, 1)} = 7 THEN 'islet' ELSE 'region-' || n % 50 END",
        "platform": "'robot-' || n % 5",
    }
    insert_rows(connection, "sequences", numbers(count), {
        "id": f"hex_id({SEQUENCE}, n)", "owner_id": owner(count), "name": "'run-' || n", **words,
        "is_public": "n % 500 = 0",
        "deleted_ns": f"CASE WHEN n % 100 = 99 THEN {NOW_NS} END", "created_ns": _aged(count),
    })  # fmt: skip
    insert_rows(connection, "uploads", numbers(count), {
        "id": f"hex_id({UPLOAD}, n)", "owner_id": owner(count), "purpose": "'recording'",
        "filename": "'run-' || n || '.mcap'", "target_id": f"hex_id({SEQUENCE}, n)",
        "length_bytes": "9000000000", "sha256": f"hex_sha({RECORDING}, n)",
        "state": f"CASE WHEN n > {count} - 200 THEN 'open' ELSE 'consumed' END",
        "expires_ns": str(NOW_NS + 10**15),
    })  # fmt: skip
    bag = {"filename": "'run-' || n || '.mcap'", "size_bytes": "9000000000", "sha256": f"hex_sha({RECORDING}, n)"}
    insert_rows(connection, "recordings", numbers(count), {
        "id": f"hex_id({RECORDING}, n)", "sequence_id": f"hex_id({SEQUENCE}, n)", **bag, "state": "'registered'",
    })  # fmt: skip
    insert_rows(connection, "recording_files", numbers(count), {
        "id": f"hex_id({OTHER}, n)", "recording_id": f"hex_id({RECORDING}, n)", "ordinal": "0", **bag,
        "upload_id": f"hex_id({UPLOAD}, n)", "blob_sha256": f"hex_sha({RECORDING}, n)",
    })  # fmt: skip


def _jobs(connection: Connection, amounts: Amounts) -> None:
    """Insert a run and its jobs for every sequence; the last ones are queued, 1,000 are running."""
    count, last = amounts.sequences, amounts.jobs_each
    id_of = f"hex_id({JOB}, n * {last + 1} + %s)"
    source = f"{numbers(count)}, generate_series(0, {last}) AS k"
    waits, runs, ends = _stands(amounts)
    state = f"CASE WHEN {waits} THEN 'queued' WHEN {runs} AND {ends} THEN 'running'"
    insert_rows(connection, "jobs", source, {
        "id": id_of % "k", "root_id": id_of % "0", "owner_id": owner(count), "sequence_id": f"hex_id({SEQUENCE}, n)",
        "kind": "(ARRAY['sequence.process', 'ingest.synchronise', 'labeler.frames'])[1 + least(k, 2)]",
        "queue": "(ARRAY['', 'ingest', 'labeler'])[1 + least(k, 2)]",
        "state": f"{state} WHEN n % 200 = 3 AND {ends} THEN 'failed' ELSE 'succeeded' END",
        "needs_left": f"CASE WHEN {waits} AND k > 1 THEN 1 ELSE 0 END", "attempt": f"1 - ({waits})::int",
        "attempts_left": "CASE WHEN n % 400 = 3 THEN 0 ELSE 2 END", "created_ns": _aged(count),
        "started_ns": f"CASE WHEN NOT ({waits}) THEN {_aged(count)} END",
        "finished_ns": f"CASE WHEN NOT ({waits} OR {runs} AND {ends}) THEN {_aged(count)} END",
    }, "1")  # fmt: skip
    begun = f"{source} WHERE k > 0 AND NOT ({waits}) AND (n % 4 = 0 OR {runs})"
    insert_rows(connection, "job_attempts", begun, {
        "job_id": id_of % "k", "number": "1", "worker": "'worker-' || n % 1000", "cpu_s": "1.5",
        "outcome": f"CASE WHEN {runs} AND {ends} THEN '' ELSE 'succeeded' END",
    })  # fmt: skip


def _stands(amounts: Amounts) -> tuple[str, str, str]:
    """Return SQL for whether a run waits, whether it runs, and whether a job is its row or its last one."""
    first = amounts.sequences - amounts.backlog
    return f"n > {first}", f"n BETWEEN {first - 999} AND {first}", f"k IN (0, {amounts.jobs_each})"


def _made(connection: Connection, amounts: Amounts) -> None:
    count, each = amounts.sequences, amounts.artefacts_each
    job_id = f"hex_id({JOB}, n * {amounts.jobs_each + 1})"
    key = "'blobs/' || substr(sha, 1, 2) || '/' || sha || '.0a1b2c3d'"
    of_labels = f"SELECT hex_sha({ARTEFACT}, n) AS sha FROM generate_series(0::bigint, {count * each - 1}) AS n"
    of_bags = f"SELECT hex_sha({RECORDING}, n) FROM {numbers(count)}"
    blob = {"sha256": "sha", "object_key": key, "size_bytes": "1000000", "created_ns": "1"}
    insert_rows(connection, "blobs", f"({of_labels} UNION ALL {of_bags}) AS every", blob, "1")
    insert_rows(connection, "label_sets", numbers(count), {
        "id": f"hex_id({LABELS}, n)", "sequence_id": f"hex_id({SEQUENCE}, n)", "recipe": f"hex_sha({LABELS}, n)",
        "job_id": job_id, "code_version": "'1'", "frames": "600",
        "duration_ns": "60000000000", "distance_m": "80", "t_voxels": "5", "p_voxels": "6", "n_voxels": "7",
        "free_voxels": "8",
    })  # fmt: skip
    files = "(ARRAY['report.json','thumbnail.png','mesh.ply','labels/000000.pack'])[1 + k]"
    insert_rows(connection, "artefacts", f"{numbers(count)}, generate_series(0, {each - 1}) AS k", {
        "id": f"hex_id({ARTEFACT}, n * {each} + k)", "label_set_id": f"hex_id({LABELS}, n)",
        "name": f"COALESCE({files}, 'labels/' || k || '.pack')", "media_type": "'application/octet-stream'",
        "blob_sha256": f"hex_sha({ARTEFACT}, (n - 1) * {each} + k)", "size_bytes": "1000000",
    }, "1")  # fmt: skip
    frames = f"{numbers(count)}, generate_series(0, {amounts.frames_each - 1}) AS k"
    insert_rows(connection, "labelled_frames", frames, {
        "label_set_id": f"hex_id({LABELS}, n)", "ordinal": "k", "token": "md5('frame' || n || ':' || k)",
        "stamp_ns": "k * 100000000", "pack_id": f"hex_id({ARTEFACT}, n * {each} + 3)", "offset_bytes": "k * 2000",
        "length_bytes": "2000", "sha256": f"hex_sha({OTHER}, n)",
    })  # fmt: skip
    insert_rows(connection, "exports", numbers(count) + " WHERE n % 2 = 0", {
        "id": f"hex_id({EXPORT}, n)", "sequence_id": f"hex_id({SEQUENCE}, n)", "label_set_id": f"hex_id({LABELS}, n)",
        "job_id": job_id, "format": "'playback'", "recipe": f"hex_sha({EXPORT}, n)",
        "code_version": "'1'", "finished_ns": str(NOW_NS),
    })  # fmt: skip
    insert_rows(connection, "previews", numbers(count), {
        "id": f"hex_id({PREVIEW}, n)", "sequence_id": f"hex_id({SEQUENCE}, n)", "name": "'contact-sheet.jpg'",
        "recording_id": f"hex_id({RECORDING}, n)", "media_type": "'image/jpeg'", "size_bytes": "1000",
        "blob_sha256": f"hex_sha({RECORDING}, n)",
    })  # fmt: skip


def _ledgers(connection: Connection, amounts: Amounts) -> None:
    count = amounts.sequences
    insert_rows(connection, "quota_ledger", numbers(count), {
        "id": f"hex_id({OTHER}, n)", "owner_id": owner(count), "kind": "'bytes'", "amount": "1000",
        "reason": "'upload'", "subject_id": f"hex_id({UPLOAD}, n)",
    })  # fmt: skip
    act = "(ARRAY['sequence.create','recording.add','sequence.process'])[1 + n % 3]"
    insert_rows(connection, "audit_log", numbers(2 * count), {
        "number": "n", "actor_id": owner(count), "actor": f"'person-' || (n * n) % {OWNERS}",
        "act": f"CASE WHEN n % 100003 = 5 THEN 'token.revoke' ELSE {act} END",
        "subject_id": f"hex_id({SEQUENCE}, n / 2)", "hash": f"hex_sha({OTHER}, n)",
    })  # fmt: skip
