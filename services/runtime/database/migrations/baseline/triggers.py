"""Triggers by which the database refuses changes; on PostgreSQL each calls a function."""

from collections.abc import Iterator

from sqlalchemy import Connection

FROZEN = (
    (
        "refuse_dataset_change",
        "a version of the dataset does not change",
        ("datasets", "dataset_parts", "dataset_packs", "dataset_members", "dataset_inputs", "dataset_input_packs"),
    ),
    ("refuse_0009_change", "what a board showed does not change", ("activations",)),
    ("refuse_0010_change", "scores and the ledger of scorings are only added to", ("scores", "scoring_ledger")),
)
"""Tables whose rows never change: the function of their triggers on PostgreSQL and its sentence."""
FUNCTIONS = ("refuse_audit_change", "refuse_audit_delete", *(function for function, _, _ in FROZEN))
CUT = "(SELECT COALESCE(MAX(number), 0) FROM audit_anchors)"
"""The last line of the audit log that may be deleted."""
APPEND_ONLY = "audit_log is append-only"


def create_triggers(connection: Connection) -> None:
    made = _on_postgresql() if connection.dialect.name == "postgresql" else _on_sqlite()
    for statement in made:
        connection.exec_driver_sql(statement)


def drop_functions(connection: Connection) -> None:
    if connection.dialect.name == "postgresql":
        for function in FUNCTIONS:
            connection.exec_driver_sql(f"DROP FUNCTION {function}()")


def _on_sqlite() -> Iterator[str]:
    for _, sentence, tables in FROZEN:
        for table in tables:
            yield f"CREATE TRIGGER {table}_frozen BEFORE UPDATE ON {table} {_abort(sentence)}"
    for table, condition in (("audit_log", f"WHEN OLD.number > {CUT} "), ("audit_anchors", "")):
        yield f"CREATE TRIGGER {table}_no_update BEFORE UPDATE ON {table} {_abort(APPEND_ONLY)}"
        yield f"CREATE TRIGGER {table}_no_delete BEFORE DELETE ON {table} {condition}{_abort(APPEND_ONLY)}"


def _abort(sentence: str) -> str:
    return f"BEGIN SELECT RAISE(ABORT, '{sentence}'); END"


def _on_postgresql() -> Iterator[str]:
    for function, sentence, tables in FROZEN:
        yield _function(function, f"RAISE EXCEPTION '{sentence}';")
        for table in tables:
            yield f"CREATE TRIGGER {table}_frozen BEFORE UPDATE ON {table} {_statement(function)}"
    raised = f"RAISE EXCEPTION '{APPEND_ONLY}';"
    yield _function("refuse_audit_change", raised)
    yield _function("refuse_audit_delete", f"IF OLD.number > {CUT} THEN {raised} END IF; RETURN OLD;")
    for table, changes in (("audit_log", "UPDATE OR TRUNCATE"), ("audit_anchors", "UPDATE OR DELETE OR TRUNCATE")):
        yield f"CREATE TRIGGER {table}_append_only BEFORE {changes} ON {table} {_statement('refuse_audit_change')}"
    yield (
        "CREATE TRIGGER audit_log_cut_only BEFORE DELETE ON audit_log "
        "FOR EACH ROW EXECUTE FUNCTION refuse_audit_delete()"
    )


def _function(name: str, body: str) -> str:
    return f"CREATE FUNCTION {name}() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN {body} END $$"


def _statement(function: str) -> str:
    return f"FOR EACH STATEMENT EXECUTE FUNCTION {function}()"
