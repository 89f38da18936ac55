"""Benchmarks: phases and their rules, ground truths, the active evaluation version, inputs of participants.

**Conventions.** What a board showed when is only added to.
"""

import sqlalchemy as sa
from alembic import op

revision = "0009"
down_revision = "0008"
branch_labels = None
depends_on = None

TABLES = (
    "benchmarks",
    "phases",
    "reported",
    "ground_truths",
    "rescores",
    "activations",
    "phase_inputs",
    "phase_input_packs",
    "team_invitations",
    "phase_teams",
)
FROZEN = ("activations",)
REFUSAL = "what a board showed does not change"


def upgrade() -> None:
    _benchmarks()
    _phases()
    _reported()
    _ground_truths()
    _rescores()
    _activations()
    _phase_inputs()
    _phase_input_packs()
    _team_invitations()
    _phase_teams()
    _freeze()


def downgrade() -> None:
    for table in reversed(TABLES):
        op.drop_table(table)  # and its triggers with it
    if op.get_bind().dialect.name == "postgresql":
        op.execute("DROP FUNCTION refuse_0009_change()")


def _benchmarks() -> None:
    op.create_table(
        "benchmarks",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("name", sa.String(length=64), nullable=False),
        sa.Column("title", sa.String(length=200), nullable=False),
        sa.Column("description", sa.Text(), nullable=False),
        sa.Column("created_by", sa.String(length=32), nullable=False),
        sa.Column("created_ns", sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(["created_by"], ["users.id"], name=op.f("fk_benchmarks_created_by")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_benchmarks")),
        sa.UniqueConstraint("name", name=op.f("uq_benchmarks_name")),
    )


def _phases() -> None:
    op.create_table(
        "phases",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("benchmark_id", sa.String(length=32), nullable=False),
        sa.Column("name", sa.String(length=32), nullable=False),
        sa.Column("title", sa.String(length=200), nullable=False),
        sa.Column("dataset_id", sa.String(length=32), nullable=False),
        sa.Column("part", sa.String(length=8), nullable=False),
        sa.Column("mask", sa.String(length=8), nullable=False),
        sa.Column("is_hidden", sa.Boolean(), nullable=False),
        sa.Column("opens_ns", sa.BigInteger(), nullable=True),
        sa.Column("closes_ns", sa.BigInteger(), nullable=True),
        sa.Column("named_from_ns", sa.BigInteger(), nullable=True),
        sa.Column("scorings_per_window", sa.Integer(), nullable=True),
        sa.Column("window_ns", sa.BigInteger(), nullable=False),
        sa.Column("scorings_total", sa.Integer(), nullable=True),
        sa.Column("validations_per_day", sa.Integer(), nullable=False),
        sa.Column("team_members", sa.Integer(), nullable=False),
        sa.Column("revision", sa.Integer(), nullable=False),
        sa.Column("created_ns", sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(
            ["benchmark_id"], ["benchmarks.id"], name=op.f("fk_phases_benchmark_id"), ondelete="CASCADE"
        ),
        sa.ForeignKeyConstraint(["dataset_id"], ["datasets.id"], name=op.f("fk_phases_dataset_id")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_phases")),
    )
    op.create_index(op.f("ix_phases_dataset_id"), "phases", ["dataset_id"], unique=False)
    op.create_index("uq_phases_benchmark_name", "phases", ["benchmark_id", "name"], unique=True)


def _reported() -> None:
    op.create_table(
        "reported",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("phase_id", sa.String(length=32), nullable=False),
        sa.Column("method", sa.String(length=100), nullable=False),
        sa.Column("modality", sa.String(length=8), nullable=False),
        sa.Column("source", sa.String(length=300), nullable=False),
        sa.Column("iou_occ", sa.Double(), nullable=True),
        sa.Column("iou_t", sa.Double(), nullable=True),
        sa.Column("iou_p", sa.Double(), nullable=True),
        sa.Column("iou_n", sa.Double(), nullable=True),
        sa.Column("miou", sa.Double(), nullable=True),
        sa.Column("created_ns", sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(["phase_id"], ["phases.id"], name=op.f("fk_reported_phase_id"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_reported")),
    )
    op.create_index("uq_reported_phase_method", "reported", ["phase_id", "method", "modality"], unique=True)


def _ground_truths() -> None:
    op.create_table(
        "ground_truths",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("phase_id", sa.String(length=32), nullable=False),
        sa.Column("number", sa.Integer(), nullable=False),
        sa.Column("dataset_id", sa.String(length=32), nullable=False),
        sa.Column("part", sa.String(length=8), nullable=False),
        sa.Column("mask", sa.String(length=8), nullable=False),
        sa.Column("job_id", sa.String(length=32), nullable=True),
        sa.Column("sha256", sa.String(length=64), nullable=False),
        sa.Column("frames", sa.Integer(), nullable=False),
        sa.Column("manifest_sha256", sa.String(length=64), nullable=True),
        sa.Column("pack_sha256", sa.String(length=64), nullable=True),
        sa.Column("facts", sa.JSON(), nullable=False),
        sa.Column("created_by", sa.String(length=32), nullable=False),
        sa.Column("created_ns", sa.BigInteger(), nullable=False),
        sa.Column("ready_ns", sa.BigInteger(), nullable=True),
        sa.ForeignKeyConstraint(["created_by"], ["users.id"], name=op.f("fk_ground_truths_created_by")),
        sa.ForeignKeyConstraint(["dataset_id"], ["datasets.id"], name=op.f("fk_ground_truths_dataset_id")),
        sa.ForeignKeyConstraint(["job_id"], ["jobs.id"], name=op.f("fk_ground_truths_job_id")),
        sa.ForeignKeyConstraint(["manifest_sha256"], ["blobs.sha256"], name=op.f("fk_ground_truths_manifest_sha256")),
        sa.ForeignKeyConstraint(["pack_sha256"], ["blobs.sha256"], name=op.f("fk_ground_truths_pack_sha256")),
        sa.ForeignKeyConstraint(
            ["phase_id"], ["phases.id"], name=op.f("fk_ground_truths_phase_id"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_ground_truths")),
    )
    op.create_index(op.f("ix_ground_truths_dataset_id"), "ground_truths", ["dataset_id"], unique=False)
    op.create_index(op.f("ix_ground_truths_manifest_sha256"), "ground_truths", ["manifest_sha256"], unique=False)
    op.create_index(op.f("ix_ground_truths_pack_sha256"), "ground_truths", ["pack_sha256"], unique=False)
    op.create_index("uq_ground_truths_phase_number", "ground_truths", ["phase_id", "number"], unique=True)


def _rescores() -> None:
    op.create_table(
        "rescores",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("phase_id", sa.String(length=32), nullable=False),
        sa.Column("truth_id", sa.String(length=32), nullable=False),
        sa.Column("metric", sa.String(length=32), nullable=False),
        sa.Column("job_id", sa.String(length=32), nullable=True),
        sa.Column("reason", sa.String(length=512), nullable=False),
        sa.Column("created_by", sa.String(length=32), nullable=False),
        sa.Column("created_ns", sa.BigInteger(), nullable=False),
        sa.Column("activated_ns", sa.BigInteger(), nullable=True),
        sa.Column("abandoned_ns", sa.BigInteger(), nullable=True),
        sa.ForeignKeyConstraint(["created_by"], ["users.id"], name=op.f("fk_rescores_created_by")),
        sa.ForeignKeyConstraint(["job_id"], ["jobs.id"], name=op.f("fk_rescores_job_id")),
        sa.ForeignKeyConstraint(["phase_id"], ["phases.id"], name=op.f("fk_rescores_phase_id"), ondelete="CASCADE"),
        sa.ForeignKeyConstraint(["truth_id"], ["ground_truths.id"], name=op.f("fk_rescores_truth_id")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_rescores")),
    )
    op.create_index(op.f("ix_rescores_phase_id"), "rescores", ["phase_id"], unique=False)
    op.create_index(op.f("ix_rescores_truth_id"), "rescores", ["truth_id"], unique=False)


def _activations() -> None:
    op.create_table(
        "activations",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("phase_id", sa.String(length=32), nullable=False),
        sa.Column("truth_id", sa.String(length=32), nullable=False),
        sa.Column("metric", sa.String(length=32), nullable=False),
        sa.Column("rescore_id", sa.String(length=32), nullable=True),
        sa.Column("activated_by", sa.String(length=32), nullable=False),
        sa.Column("activated_ns", sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(["activated_by"], ["users.id"], name=op.f("fk_activations_activated_by")),
        sa.ForeignKeyConstraint(["phase_id"], ["phases.id"], name=op.f("fk_activations_phase_id"), ondelete="CASCADE"),
        sa.ForeignKeyConstraint(["rescore_id"], ["rescores.id"], name=op.f("fk_activations_rescore_id")),
        sa.ForeignKeyConstraint(["truth_id"], ["ground_truths.id"], name=op.f("fk_activations_truth_id")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_activations")),
    )
    op.create_index(op.f("ix_activations_phase_id"), "activations", ["phase_id"], unique=False)
    op.create_index(op.f("ix_activations_truth_id"), "activations", ["truth_id"], unique=False)


def _phase_inputs() -> None:
    op.create_table(
        "phase_inputs",
        sa.Column("phase_id", sa.String(length=32), nullable=False),
        sa.Column("name", sa.String(length=100), nullable=False),
        sa.Column("index_sha256", sa.String(length=64), nullable=False),
        sa.Column("files", sa.Integer(), nullable=False),
        sa.Column("size_bytes", sa.BigInteger(), nullable=False),
        sa.Column("tar_bytes", sa.BigInteger(), nullable=False),
        sa.Column("tar_sha256", sa.String(length=64), nullable=False),
        sa.Column("created_ns", sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(["index_sha256"], ["blobs.sha256"], name=op.f("fk_phase_inputs_index_sha256")),
        sa.ForeignKeyConstraint(["phase_id"], ["phases.id"], name=op.f("fk_phase_inputs_phase_id"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("phase_id", "name", name=op.f("pk_phase_inputs")),
    )
    op.create_index(op.f("ix_phase_inputs_index_sha256"), "phase_inputs", ["index_sha256"], unique=False)


def _phase_input_packs() -> None:
    op.create_table(
        "phase_input_packs",
        sa.Column("phase_id", sa.String(length=32), nullable=False),
        sa.Column("name", sa.String(length=100), nullable=False),
        sa.Column("ordinal", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("blob_sha256", sa.String(length=64), nullable=False),
        sa.ForeignKeyConstraint(["blob_sha256"], ["blobs.sha256"], name=op.f("fk_phase_input_packs_blob_sha256")),
        sa.ForeignKeyConstraint(
            ["phase_id"], ["phases.id"], name=op.f("fk_phase_input_packs_phase_id"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("phase_id", "name", "ordinal", name=op.f("pk_phase_input_packs")),
    )
    op.create_index(op.f("ix_phase_input_packs_blob_sha256"), "phase_input_packs", ["blob_sha256"], unique=False)


def _team_invitations() -> None:
    op.create_table(
        "team_invitations",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("team_id", sa.String(length=32), nullable=False),
        sa.Column("secret_hash", sa.String(length=64), nullable=False),
        sa.Column("created_by", sa.String(length=32), nullable=False),
        sa.Column("created_ns", sa.BigInteger(), nullable=False),
        sa.Column("expires_ns", sa.BigInteger(), nullable=False),
        sa.Column("used_by", sa.String(length=32), nullable=True),
        sa.Column("used_ns", sa.BigInteger(), nullable=True),
        sa.ForeignKeyConstraint(["created_by"], ["users.id"], name=op.f("fk_team_invitations_created_by")),
        sa.ForeignKeyConstraint(
            ["team_id"], ["teams.id"], name=op.f("fk_team_invitations_team_id"), ondelete="CASCADE"
        ),
        sa.ForeignKeyConstraint(["used_by"], ["users.id"], name=op.f("fk_team_invitations_used_by")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_team_invitations")),
        sa.UniqueConstraint("secret_hash", name=op.f("uq_team_invitations_secret_hash")),
    )
    op.create_index(op.f("ix_team_invitations_team_id"), "team_invitations", ["team_id"], unique=False)


def _phase_teams() -> None:
    op.create_table(
        "phase_teams",
        sa.Column("phase_id", sa.String(length=32), nullable=False),
        sa.Column("user_id", sa.String(length=32), nullable=False),
        sa.Column("team_id", sa.String(length=32), nullable=False),
        sa.ForeignKeyConstraint(["phase_id"], ["phases.id"], name=op.f("fk_phase_teams_phase_id"), ondelete="CASCADE"),
        sa.ForeignKeyConstraint(["team_id"], ["teams.id"], name=op.f("fk_phase_teams_team_id"), ondelete="CASCADE"),
        sa.ForeignKeyConstraint(["user_id"], ["users.id"], name=op.f("fk_phase_teams_user_id"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("phase_id", "user_id", name=op.f("pk_phase_teams")),
    )
    op.create_index(op.f("ix_phase_teams_team_id"), "phase_teams", ["team_id"], unique=False)


def _freeze() -> None:
    if op.get_bind().dialect.name == "postgresql":
        body = f"BEGIN RAISE EXCEPTION '{REFUSAL}'; END"
        op.execute(f"CREATE FUNCTION refuse_0009_change() RETURNS trigger LANGUAGE plpgsql AS $$ {body} $$")
    for table in FROZEN:
        if op.get_bind().dialect.name == "postgresql":
            refuse = "FOR EACH STATEMENT EXECUTE FUNCTION refuse_0009_change()"
        else:
            refuse = f"BEGIN SELECT RAISE(ABORT, '{REFUSAL}'); END"
        op.execute(f"CREATE TRIGGER {table}_frozen BEFORE UPDATE ON {table} {refuse}")
