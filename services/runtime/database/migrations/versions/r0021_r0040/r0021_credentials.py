"""Tokens know what made them; addresses that signed in are remembered, and that a sequence was public once."""

import json

import sqlalchemy as sa
from alembic import op

revision = "0021"
down_revision = "0020"
branch_labels = None
depends_on = None

CHANGES = "SELECT subject_id, logged_ns, facts FROM audit_log WHERE act = 'sequence.change' ORDER BY number"


def upgrade() -> None:
    with op.batch_alter_table("tokens") as tokens:
        tokens.add_column(sa.Column("parent_id", sa.String(length=32), nullable=True))
        tokens.create_foreign_key(op.f("fk_tokens_parent_id"), "tokens", ["parent_id"], ["id"], ondelete="CASCADE")
    op.create_index(op.f("ix_tokens_parent_id"), "tokens", ["parent_id"], unique=False)
    op.create_table(
        "sign_in_addresses",
        sa.Column("key", sa.String(length=64), nullable=False),
        sa.Column("user_id", sa.String(length=32), nullable=False),
        sa.Column("used_ns", sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(
            ["user_id"], ["users.id"], name=op.f("fk_sign_in_addresses_user_id"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("key", name=op.f("pk_sign_in_addresses")),
    )
    op.create_index(op.f("ix_sign_in_addresses_user_id"), "sign_in_addresses", ["user_id"], unique=False)
    op.add_column("sequences", sa.Column("published_ns", sa.BigInteger(), nullable=True))
    _remember_what_was_public()


def downgrade() -> None:
    op.drop_column("sequences", "published_ns")
    op.drop_index(op.f("ix_sign_in_addresses_user_id"), table_name="sign_in_addresses")
    op.drop_table("sign_in_addresses")
    op.drop_index(op.f("ix_tokens_parent_id"), table_name="tokens")
    with op.batch_alter_table("tokens") as tokens:
        tokens.drop_constraint(op.f("fk_tokens_parent_id"), type_="foreignkey")
        tokens.drop_column("parent_id")


def _remember_what_was_public() -> None:
    """By the audit log, as far back as it goes; what is public now and is not in it was so from its making on."""
    first: dict[str, int] = {}
    for sequence_id, logged_ns, facts in op.get_bind().execute(sa.text(CHANGES)):
        said = json.loads(facts) if isinstance(facts, str) else facts
        if said.get("is_public") is True:
            first.setdefault(sequence_id, logged_ns)
    written = sa.text("UPDATE sequences SET published_ns = :at WHERE id = :id")
    for sequence_id, logged_ns in first.items():
        op.get_bind().execute(written, {"at": logged_ns, "id": sequence_id})
    op.execute("UPDATE sequences SET published_ns = created_ns WHERE is_public AND published_ns IS NULL")
