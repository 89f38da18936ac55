"""Jobs that cannot be lost.

The database is the truth, the broker only a bell (design §5). Read in this order: `specs` (what a job is asked to be
and what it answers), `queueing` (rows come to be), `claiming` (a worker takes one), `running` (the attempt),
`finishing` (it ends, and what waited becomes ready), `sweeping` (what died is taken up again), `steering` (cancel,
terminate, retry), `reading` (how far it is).

**Conventions.** Every change of state is a compare-and-set on (state, attempt): whoever loses the race changes nothing.
An attempt is alive while its `heartbeats` grow, as judged by the observer's monotonic clock, so no clock that is set
back or forward loses or doubles work. Whoever finishes a job locks its run's row first.
"""
