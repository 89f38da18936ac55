"""Recordings of several files, their previews; profiles of robots; when a calibration is true.

**Conventions.** Every recording there is becomes one of one file; the file takes over its upload and its blob. Going
back is refused where a recording of several files would have to be torn apart.
"""

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"
branch_labels = None
depends_on = None


def upgrade() -> None:
    _recording_files()
    _profiles()
    _slim_recordings()
    _previews()
    _calibrations()


def downgrade() -> None:
    with op.batch_alter_table("calibrations") as calibrations:
        for name in ("valid_to_ns", "valid_from_ns", "format"):
            calibrations.drop_column(name)
    op.drop_table("previews")
    op.drop_table("profiles")
    _widen_recordings()
    op.drop_table("recording_files")


def _recording_files() -> None:
    op.create_table(
        "recording_files",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("recording_id", sa.String(length=32), nullable=False),
        sa.Column("ordinal", sa.Integer(), nullable=False),
        sa.Column("upload_id", sa.String(length=32), nullable=True),
        sa.Column("filename", sa.String(length=255), nullable=False),
        sa.Column("size_bytes", sa.BigInteger(), nullable=False),
        sa.Column("sha256", sa.String(length=64), nullable=False),
        sa.Column("blob_sha256", sa.String(length=64), nullable=True),
        sa.Column("recovered_blob_sha256", sa.String(length=64), nullable=True),
        sa.ForeignKeyConstraint(["blob_sha256"], ["blobs.sha256"], name=op.f("fk_recording_files_blob_sha256")),
        sa.ForeignKeyConstraint(
            ["recording_id"], ["recordings.id"], name=op.f("fk_recording_files_recording_id"), ondelete="CASCADE"
        ),
        sa.ForeignKeyConstraint(
            ["recovered_blob_sha256"], ["blobs.sha256"], name=op.f("fk_recording_files_recovered_blob_sha256")
        ),
        sa.ForeignKeyConstraint(["upload_id"], ["uploads.id"], name=op.f("fk_recording_files_upload_id")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_recording_files")),
        sa.UniqueConstraint("upload_id", name=op.f("uq_recording_files_upload_id")),
    )
    for column in ("blob_sha256", "recovered_blob_sha256"):
        op.create_index(op.f(f"ix_recording_files_{column}"), "recording_files", [column], unique=False)
    op.create_index("uq_recording_files_recording_ordinal", "recording_files", ["recording_id", "ordinal"], unique=True)
    same = "upload_id, filename, size_bytes, sha256, blob_sha256"
    files = f"recording_files (id, recording_id, ordinal, {same})"
    op.execute(f"INSERT INTO {files} SELECT id, id, 0, {same} FROM recordings")


def _profiles() -> None:
    op.create_table(
        "profiles",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("owner_id", sa.String(length=32), nullable=False),
        sa.Column("platform", sa.String(length=64), nullable=False),
        sa.Column("topics", sa.JSON(), nullable=False),
        sa.Column("revision", sa.Integer(), nullable=False),
        sa.Column("created_ns", sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(["owner_id"], ["users.id"], name=op.f("fk_profiles_owner_id")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_profiles")),
    )
    op.create_index("uq_profiles_owner_platform", "profiles", ["owner_id", "platform"], unique=True)


def _slim_recordings() -> None:
    with op.batch_alter_table("recordings") as recordings:
        recordings.drop_index("ix_recordings_blob_sha256")
        recordings.drop_constraint("uq_recordings_upload_id", type_="unique")
        for column in ("upload_id", "blob_sha256"):
            recordings.drop_constraint(f"fk_recordings_{column}", type_="foreignkey")
            recordings.drop_column(column)
        recordings.add_column(sa.Column("quality", sa.JSON(), nullable=True))


def _widen_recordings() -> None:
    several = sa.text("SELECT count(*) FROM recording_files WHERE ordinal > 0")
    if count := op.get_bind().scalar(several):
        raise RuntimeError(f"{count} files belong to recordings of several files; delete those recordings first")
    with op.batch_alter_table("recordings") as recordings:
        recordings.drop_column("quality")
        recordings.add_column(sa.Column("upload_id", sa.String(length=32), nullable=True))
        recordings.add_column(sa.Column("blob_sha256", sa.String(length=64), nullable=True))
        recordings.create_foreign_key("fk_recordings_upload_id", "uploads", ["upload_id"], ["id"])
        recordings.create_foreign_key("fk_recordings_blob_sha256", "blobs", ["blob_sha256"], ["sha256"])
        recordings.create_unique_constraint("uq_recordings_upload_id", ["upload_id"])
        recordings.create_index("ix_recordings_blob_sha256", ["blob_sha256"], unique=False)
    for column in ("upload_id", "blob_sha256"):
        of_file = f"(SELECT {column} FROM recording_files WHERE recording_id = recordings.id)"
        op.execute(f"UPDATE recordings SET {column} = {of_file}")


def _previews() -> None:
    op.create_table(
        "previews",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("sequence_id", sa.String(length=32), nullable=False),
        sa.Column("recording_id", sa.String(length=32), nullable=True),
        sa.Column("recipe", sa.String(length=64), nullable=False),
        sa.Column("name", sa.String(length=128), nullable=False),
        sa.Column("media_type", sa.String(length=64), nullable=False),
        sa.Column("blob_sha256", sa.String(length=64), nullable=False),
        sa.Column("size_bytes", sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(["blob_sha256"], ["blobs.sha256"], name=op.f("fk_previews_blob_sha256")),
        sa.ForeignKeyConstraint(
            ["recording_id"], ["recordings.id"], name=op.f("fk_previews_recording_id"), ondelete="CASCADE"
        ),
        sa.ForeignKeyConstraint(
            ["sequence_id"], ["sequences.id"], name=op.f("fk_previews_sequence_id"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_previews")),
    )
    op.create_index("ix_previews_sequence_id", "previews", ["sequence_id"], unique=False)
    op.create_index(op.f("ix_previews_blob_sha256"), "previews", ["blob_sha256"], unique=False)
    op.create_index("uq_previews_recording_name", "previews", ["recording_id", "name"], unique=True)
    op.create_index(
        "uq_previews_sequence_recipe_name",
        "previews",
        ["sequence_id", "recipe", "name"],
        unique=True,
        sqlite_where=sa.text("recording_id IS NULL"),
        postgresql_where=sa.text("recording_id IS NULL"),
    )


def _calibrations() -> None:
    """Those there are were written in the native format, the only one that was read."""
    native = sa.Column("format", sa.String(length=32), nullable=False, server_default="native")
    with op.batch_alter_table("calibrations") as calibrations:
        calibrations.add_column(native)
        calibrations.add_column(sa.Column("valid_from_ns", sa.BigInteger(), nullable=True))
        calibrations.add_column(sa.Column("valid_to_ns", sa.BigInteger(), nullable=True))
    with op.batch_alter_table("calibrations") as calibrations:
        calibrations.alter_column("format", server_default=None)
