"""Wrong passwords are counted; sessions know when they were last used; the audit log may be cut at an anchor."""

import sqlalchemy as sa
from alembic import op

revision = "0017"
down_revision = "0016"
branch_labels = None
depends_on = None

REFUSAL = "audit_log is append-only"
CUT = "(SELECT COALESCE(MAX(number), 0) FROM audit_anchors)"
STATEMENTS = "CREATE TRIGGER audit_log_append_only BEFORE {} ON audit_log FOR EACH STATEMENT EXECUTE FUNCTION {}()"
POSTGRES = (
    "DROP TRIGGER audit_log_append_only ON audit_log",
    STATEMENTS.format("UPDATE OR TRUNCATE", "refuse_audit_change"),
    f"CREATE FUNCTION refuse_audit_delete() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN "
    f"IF OLD.number > {CUT} THEN RAISE EXCEPTION '{REFUSAL}'; END IF; RETURN OLD; END $$",
    "CREATE TRIGGER audit_log_cut_only BEFORE DELETE ON audit_log FOR EACH ROW EXECUTE FUNCTION refuse_audit_delete()",
    "CREATE TRIGGER audit_anchors_append_only BEFORE UPDATE OR DELETE OR TRUNCATE ON audit_anchors "
    "FOR EACH STATEMENT EXECUTE FUNCTION refuse_audit_change()",
)
POSTGRES_BACK = (
    "DROP TRIGGER audit_anchors_append_only ON audit_anchors",
    "DROP TRIGGER audit_log_cut_only ON audit_log",
    "DROP FUNCTION refuse_audit_delete()",
    "DROP TRIGGER audit_log_append_only ON audit_log",
    STATEMENTS.format("UPDATE OR DELETE OR TRUNCATE", "refuse_audit_change"),
)
REFUSE = f"BEGIN SELECT RAISE(ABORT, '{REFUSAL}'); END"
SQLITE = (
    "DROP TRIGGER audit_log_no_delete",
    f"CREATE TRIGGER audit_log_no_delete BEFORE DELETE ON audit_log WHEN OLD.number > {CUT} {REFUSE}",
    f"CREATE TRIGGER audit_anchors_no_update BEFORE UPDATE ON audit_anchors {REFUSE}",
    f"CREATE TRIGGER audit_anchors_no_delete BEFORE DELETE ON audit_anchors {REFUSE}",
)
SQLITE_BACK = (
    "DROP TRIGGER audit_anchors_no_update",
    "DROP TRIGGER audit_anchors_no_delete",
    "DROP TRIGGER audit_log_no_delete",
    f"CREATE TRIGGER audit_log_no_delete BEFORE DELETE ON audit_log {REFUSE}",
)


def upgrade() -> None:
    op.create_table(
        "sign_in_guesses",
        sa.Column("key", sa.String(length=64), nullable=False),
        sa.Column("failures", sa.Integer(), nullable=False),
        sa.Column("failed_ns", sa.BigInteger(), nullable=False),
        sa.Column("blocked_until_ns", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("key", name=op.f("pk_sign_in_guesses")),
    )
    op.create_index(op.f("ix_sign_in_guesses_failed_ns"), "sign_in_guesses", ["failed_ns"], unique=False)
    with op.batch_alter_table("web_sessions") as sessions:
        sessions.add_column(sa.Column("used_ns", sa.BigInteger(), nullable=True))
    op.execute("UPDATE web_sessions SET used_ns = created_ns")
    with op.batch_alter_table("web_sessions") as sessions:
        sessions.alter_column("used_ns", existing_type=sa.BigInteger(), nullable=False)
    op.create_table(
        "audit_anchors",
        sa.Column("number", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("hash", sa.String(length=64), nullable=False),
        sa.Column("cut_ns", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("number", name=op.f("pk_audit_anchors")),
    )
    for statement in POSTGRES if op.get_bind().dialect.name == "postgresql" else SQLITE:
        op.execute(statement)


def downgrade() -> None:
    is_postgres = op.get_bind().dialect.name == "postgresql"
    for statement in POSTGRES_BACK if is_postgres else SQLITE_BACK:
        op.execute(statement)
    op.drop_table("audit_anchors")
    with op.batch_alter_table("web_sessions") as sessions:
        sessions.drop_column("used_ns")
    op.drop_index(op.f("ix_sign_in_guesses_failed_ns"), table_name="sign_in_guesses")
    op.drop_table("sign_in_guesses")
