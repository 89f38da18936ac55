"""The schema's history: consecutive revisions, each run once on every database (`database/migrate.py`).

**Conventions.** The first revision is the baseline, the schema of the first release. Revisions are numbered; every
constraint and index is named as in `services/runtime/orm/base.py`. Tables are changed in batch mode, which SQLite
needs: it copies the table and loses its triggers, which the revision creates again. To write a new revision, run
`alembic -c services/runtime/database/migrations/alembic.ini revision --autogenerate --rev-id 0033 -m "…"` against a
migrated database. Review it before committing: autogeneration interprets a rename as a loss.
"""
