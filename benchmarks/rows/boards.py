"""A dataset version of many sequences, and twenty phases with submissions of a thousand teams.

**Conventions.** The n-th submission is of team n mod TEAMS and of phase n mod PHASES, but every second one is of phase
0, so that one board is long. Eight of ten submissions are scored, one failed, one is withdrawn; the last hundred wait.
"""

from sqlalchemy import Connection

from benchmarks.rows.bulk_inserts import insert_rows, numbers

USER, SEQUENCE, JOB, LABELS, TEAM = 1, 2, 3, 6, 10
BENCHMARK, PHASE, TRUTH, SUBMISSION, SCORE, DATASET, ACTIVATION, LEDGER = range(12, 20)
TEAMS, PHASES = 1000, 20
SECOND_NS = 10**9
SINCE_NS = 1_700_000_000 * SECOND_NS
METRIC = "stone-1"
RATIOS = ("iou_occ", "iou_t", "iou_p", "iou_n", "miou")
PHASE_OF = f"(CASE WHEN n % 2 = 0 THEN 0 ELSE n % {PHASES} END)"


def insert_dataset(connection: Connection, members: int) -> None:
    """Insert one version; the same sequences are in the draft splits."""
    made = {"id": f"hex_id({DATASET}, 0)", "name": "'v1'", "code_version": "'1'", "manifest_bytes": "10"}
    made |= {"manifest_sha256": f"hex_sha({DATASET}, 0)", "created_by": f"hex_id({USER}, 0)"}
    insert_rows(connection, "datasets", numbers(1), made)
    part = "(ARRAY['train','train','val','test'])[1 + n % 4]"
    insert_rows(connection, "dataset_members", numbers(members), {
        "dataset_id": f"hex_id({DATASET}, 0)", "sequence_id": f"hex_id({SEQUENCE}, n)", "part": part,
        "label_set_id": f"hex_id({LABELS}, n)", "name": "'run-' || n", "recipe": f"hex_sha({LABELS}, n)",
        "frames": "600", "duration_ns": "60000000000",
    })  # fmt: skip
    insert_rows(connection, "split_members", numbers(members), {"sequence_id": f"hex_id({SEQUENCE}, n)", "part": part})


def insert_boards(connection: Connection, submissions: int, runs: tuple[int, int]) -> None:
    """Insert a benchmark, its phases with one active ground truth each, and all submissions.

    `runs`: the number of runs (the last ones wait), and the number of jobs per run.
    """
    insert_rows(connection, "benchmarks", numbers(1), {
        "id": f"hex_id({BENCHMARK}, 0)", "name": "'stone'", "title": "'Stone'", "is_public": "true",
        "created_by": f"hex_id({USER}, 0)",
    })  # fmt: skip
    each = f"generate_series(0::bigint, {PHASES - 1}) AS n"
    insert_rows(connection, "phases", each, {
        "id": f"hex_id({PHASE}, n)", "benchmark_id": f"hex_id({BENCHMARK}, 0)", "name": "'phase-' || n",
        "dataset_id": f"hex_id({DATASET}, 0)", "part": "'val'", "is_hidden": "false", "scorings_per_window": "5",
    })  # fmt: skip
    insert_rows(connection, "ground_truths", each, {
        "id": f"hex_id({TRUTH}, n)", "phase_id": f"hex_id({PHASE}, n)", "number": "1", "part": "'val'", "mask": "'all'",
        "dataset_id": f"hex_id({DATASET}, 0)", "created_by": f"hex_id({USER}, 0)", "ready_ns": str(SINCE_NS),
        "frames": "6000",
    })  # fmt: skip
    insert_rows(connection, "activations", each, {
        "id": f"hex_id({ACTIVATION}, n)", "phase_id": f"hex_id({PHASE}, n)", "truth_id": f"hex_id({TRUTH}, n)",
        "metric": f"'{METRIC}'", "activated_by": f"hex_id({USER}, 0)", "activated_ns": str(SINCE_NS),
    })  # fmt: skip
    _submissions(connection, submissions, runs)


def _submissions(connection: Connection, count: int, runs: tuple[int, int]) -> None:
    waits = f"n > {count} - 100"
    run = f"CASE WHEN {waits} THEN n + {runs[0] - count} ELSE least(n, {runs[0] - 1000}) END"
    at_ns = f"{SINCE_NS} + n * {SECOND_NS}"
    of = {"phase_id": f"hex_id({PHASE}, {PHASE_OF})", "team_id": f"hex_id({TEAM}, 1 + n % {TEAMS})"}
    insert_rows(connection, "submissions", numbers(count), {
        "id": f"hex_id({SUBMISSION}, n)", **of, "user_id": f"hex_id({USER}, 1 + n % 999)", "method": "'method-' || n",
        "modality": "(ARRAY['C','L','C+L'])[1 + n % 3]", "declared_sha256": f"hex_sha({SUBMISSION}, n)",
        "size_bytes": "70000000", "job_id": f"hex_id({JOB}, ({run}) * {runs[1]})",
        "finalized_ns": at_ns, "settled_ns": f"CASE WHEN NOT ({waits}) THEN {at_ns} END",
        "state": f"CASE WHEN {waits} THEN 'queued' WHEN n % 10 = 4 THEN 'failed' ELSE 'scored' END",
        "withdrawn_ns": f"CASE WHEN n % 10 = 7 AND NOT ({waits}) THEN {at_ns} END", "created_ns": at_ns,
    })  # fmt: skip
    ratio = "((hashint8(n) & 65535) / 65535.0)"
    insert_rows(connection, "scores", f"{numbers(count - 100)} WHERE n % 10 <> 4", {
        "id": f"hex_id({SCORE}, n)", "submission_id": f"hex_id({SUBMISSION}, n)",
        "truth_id": f"hex_id({TRUTH}, {PHASE_OF})", "metric": f"'{METRIC}'", "signature": "'s'",
        **dict.fromkeys(RATIOS, ratio), "content_sha256": f"hex_sha({SCORE}, n)",
        "record": """'{"intervals": {"block": {}}, "support": {}}'::json""",
        "confusions_sha256": f"hex_sha({SCORE}, n)", "spectra_sha256": f"hex_sha({SCORE}, n)",
    })  # fmt: skip
    insert_rows(connection, "scoring_ledger", numbers(count), {
        "id": f"hex_id({LEDGER}, n)", **of, "submission_id": f"hex_id({SUBMISSION}, n)", "amount": "1",
        "reason": "'reserved'", "created_ns": at_ns,
    })  # fmt: skip
