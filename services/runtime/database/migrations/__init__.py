"""The schema's history: one revision after another, each run once on every database (`database/migrate.py`).

**Conventions.** Revisions are numbered; every constraint and index is named as `services/runtime/orm/base.py` names
it; tables are changed in batch mode, which SQLite needs. They lie in folders of twenty, which `alembic.ini` lists. A
new one is written next to the last, by
`alembic -c services/runtime/database/migrations/alembic.ini revision --autogenerate --rev-id 0031 -m "…"` against a
migrated database and is read by a person before it is committed: autogeneration sees a rename as a loss.
"""
