"""The schema's history: one revision after another, each run once on every database (`database/migrate.py`).

**Conventions.** Revisions are numbered; every constraint and index is named as `services/runtime/orm/base.py` names
it; tables are changed in batch mode, which SQLite needs. A new one begins with
`alembic -c services/runtime/database/migrations/alembic.ini revision --autogenerate --rev-id 0006 -m "…"` against a
migrated database and is read by a person before it is committed: autogeneration sees a rename as a loss.
"""
