"""The single-machine platform: Redis, API, worker and sweeper under one supervisor.

The same programs as in a cluster, by other URLs: SQLite and a local folder (`services/runtime/settings.py`). Read
`supervisor` first; `programs` says what the children are, `children` keeps them alive.
"""
