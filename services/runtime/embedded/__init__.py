"""The single-machine platform: Redis, API, worker and sweeper under one supervisor.

It runs the same programs as a cluster with other URLs: SQLite and a local folder (`services/runtime/settings.py`).
Start with `supervisor`; `programs` defines the children, `children` keeps them alive.
"""
