"""The schema's history: one revision after another, each run once on every database (`database/migrate.py`).

**Conventions.** The first revision is the baseline, the schema of the first release. Revisions are numbered; every
constraint and index is named as `services/runtime/orm/base.py` names it; tables are changed in batch mode, which SQLite
needs: it copies the table there, and loses its triggers, which the revision creates again. A new one is written by
`alembic -c services/runtime/database/migrations/alembic.ini revision --autogenerate --rev-id 0033 -m "…"` against a
migrated database and is read by a person before it is committed: autogeneration sees a rename as a loss.
"""
