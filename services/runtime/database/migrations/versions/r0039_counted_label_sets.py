"""Existing label sets and previews count against the quota of their sequences' owners."""

import time
from uuid import uuid4

import sqlalchemy as sa
from alembic import op

revision = "0039"
down_revision = "0038"
branch_labels = None
depends_on = None

REASON = "counted by 0039"
LABELS = """
    SELECT s.owner_id, l.id, SUM(a.size_bytes) FROM label_sets l
    JOIN sequences s ON s.id = l.sequence_id JOIN artefacts a ON a.label_set_id = l.id
    WHERE l.id NOT IN (SELECT subject_id FROM quota_ledger) GROUP BY s.owner_id, l.id
"""
PREVIEWS = """
    SELECT s.owner_id, COALESCE(p.recording_id, p.sequence_id), SUM(p.size_bytes) FROM previews p
    JOIN sequences s ON s.id = p.sequence_id GROUP BY s.owner_id, COALESCE(p.recording_id, p.sequence_id)
"""


def upgrade() -> None:
    connection = op.get_bind()
    names = ("id", "owner_id", "kind", "amount", "subject_id", "reason", "created_ns")
    ledger = sa.table("quota_ledger", *map(sa.column, names))
    for counted in (LABELS, PREVIEWS):
        for owner_id, subject_id, size_bytes in connection.execute(sa.text(counted)).all():
            row = {"id": uuid4().hex, "owner_id": owner_id, "kind": "bytes", "amount": int(size_bytes)}
            row |= {"subject_id": subject_id, "reason": REASON, "created_ns": time.time_ns()}
            connection.execute(ledger.insert().values(row))


def downgrade() -> None:
    op.execute(f"DELETE FROM quota_ledger WHERE reason = '{REASON}'")
