"""The job system: jobs are database rows and survive any crash.

The database is the truth, the broker only carries wake-ups (design §5). Read the modules in this order:

- `specs`: job specs and outcomes
- `enqueue`: creates rows
- `claims`: a worker takes a job
- `execution`: the attempt
- `completion`: it ends, and waiting jobs become ready
- `lease_sweep`: requeues lost attempts
- `control`: cancel, terminate, retry
- `queries`: progress

**Conventions.** Every change of state is a compare-and-set on (state, attempt): the loser of a race changes nothing. An
attempt is alive while its `heartbeats` grow, as judged by the observer's monotonic clock, so clock changes neither lose
nor duplicate work. Finishing a job locks its run's row first.
"""
