"""Indexes by which the sweeper and the limits find what waits and what is over, however much else there is."""

import sqlalchemy as sa
from alembic import op

revision = "0023"
down_revision = "0022"
branch_labels = None
depends_on = None

UPLOAD_WAITS = "state IN ('open', 'complete')"
UNSCORED_FILE = "state IN ('valid', 'invalid', 'failed', 'cancelled') AND upload_id IS NOT NULL"
PARTIAL = (
    ("ix_uploads_expiring", "uploads", ["expires_ns", "id"], UPLOAD_WAITS),
    ("ix_uploads_waiting_owner", "uploads", ["owner_id"], UPLOAD_WAITS),
    ("ix_uploads_waiting_target", "uploads", ["target_id"], UPLOAD_WAITS),
    ("ix_submissions_purgeable", "submissions", ["settled_ns"], UNSCORED_FILE),
    ("ix_submissions_withdrawn", "submissions", ["state", "withdrawn_ns"], "upload_id IS NOT NULL"),
)
WHOLE = (
    ("ix_submissions_state_created", "submissions", ["state", "created_ns", "id"]),
    ("ix_web_sessions_expires_ns", "web_sessions", ["expires_ns"]),
    ("ix_web_sessions_used_ns", "web_sessions", ["used_ns"]),
    ("ix_tokens_expires_ns", "tokens", ["expires_ns"]),
    ("ix_team_invitations_expires_ns", "team_invitations", ["expires_ns"]),
    ("ix_sign_in_addresses_used_ns", "sign_in_addresses", ["used_ns"]),
    ("ix_idempotent_replies_created_ns", "idempotent_replies", ["created_ns"]),
    ("ix_loose_objects_condemned_expected", "loose_objects", ["is_condemned", "expected_ns"]),
)
REPLACED = (
    ("ix_loose_objects_is_condemned", "loose_objects", ["is_condemned"]),
    ("ix_uploads_state", "uploads", ["state"]),
)


def upgrade() -> None:
    for name, table, _columns in REPLACED:
        op.drop_index(name, table_name=table)
    for name, table, columns, where in PARTIAL:
        op.create_index(name, table, columns, sqlite_where=sa.text(where), postgresql_where=sa.text(where))
    for name, table, columns in WHOLE:
        op.create_index(name, table, columns)
    _index_first_parts(["upload_id", "offset_bytes"])


def downgrade() -> None:
    _index_first_parts(["upload_id"])
    for name, table, _columns in WHOLE:
        op.drop_index(name, table_name=table)
    for name, table, _columns, _where in PARTIAL:
        op.drop_index(name, table_name=table)
    for name, table, columns in REPLACED:
        op.create_index(name, table, columns)


def _index_first_parts(columns: list[str]) -> None:
    """With the offset in it, the index alone answers; or SQLite walks through every part by the primary key."""
    first = sa.text("offset_bytes = 0")
    op.drop_index("ix_upload_parts_first", table_name="upload_parts")
    op.create_index("ix_upload_parts_first", "upload_parts", columns, sqlite_where=first, postgresql_where=first)
