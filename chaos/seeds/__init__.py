"""Histories of jobs from a seed: workers, sweepers, an owner and faults take turns as one die says, on one thread.

**Conventions.** What runs is the platform's own code of jobs, from `run_row` and its reporter to the sweeper, on SQLite
in memory; virtual are clocks, threads, the death of a process and the broker. A *step* is one transaction: an actor
waits at its beginning until the scheduler picks it, so two actors interleave there and nowhere else, as they do on a
database with one writer at a time. What PostgreSQL lets run at once (row locks, SKIP LOCKED) is left to
`tests/services/runtime/jobs` and `python -m chaos`. A *history* is all steps of one seed. Read `scheduler`, then
`world`, `actors` and `verdict`.
"""
