"""Histories of jobs from a seed: workers, sweepers, an owner and faults take turns at random, on one thread.

**Conventions.** A history runs the platform's job code, from `run_row` and its reporter to the sweeper, on SQLite in
memory. Clocks, threads, the death of a process and the broker are virtual. A *step* is one transaction: an actor waits
at its start until the scheduler picks the actor. So two actors interleave only there, as on a database with one writer
at a time. `tests/services/runtime/jobs` and `python -m chaos` cover transactions that run at once on PostgreSQL (row
locks, SKIP LOCKED). A *history* is all steps of one seed. Read `scheduler`, then `world`, `actors` and `verdict`.
"""
