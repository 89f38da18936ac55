"""The job system: jobs are database rows and survive any crash.

The database is the truth, the broker only carries wake-ups (design §5). Read in this order: `specs` (what a job is
asked to be and what it answers), `enqueue` (rows come to be), `claims` (a worker takes one), `execution` (the
attempt), `completion` (it ends, and what waited becomes ready), `lease_sweep` (what died is taken up again), `control`
(cancel, terminate, retry), `queries` (how far it is).

**Conventions.** Every change of state is a compare-and-set on (state, attempt): whoever loses the race changes nothing.
An attempt is alive while its `heartbeats` grow, as judged by the observer's monotonic clock, so no clock that is set
back or forward loses or doubles work. Whoever finishes a job locks its run's row first.
"""
