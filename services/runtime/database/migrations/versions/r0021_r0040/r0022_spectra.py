"""Of a score the spectra of its influences are kept, where bootstrap replicates were; old rows keep what they have."""

from services.runtime.database.migrations.renames import name_reference, rename_column

revision = "0022"
down_revision = "0021"
branch_labels = None
depends_on = None

OLD, NEW = "replicates_sha256", "spectra_sha256"


def upgrade() -> None:
    rename_column("scores", OLD, NEW)
    name_reference("scores", OLD, NEW)


def downgrade() -> None:
    rename_column("scores", NEW, OLD)
    name_reference("scores", NEW, OLD)
