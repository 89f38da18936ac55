"""A fleet of workers as events in time: what 10, 100 and 1,000 of them do with jobs as they were measured here.

Read in this order: `graph` (the jobs of one sequence, with what each costs), `sharing` (processors, lines and servers
that several use at once), `simulation` (workers take jobs as `services/runtime/jobs/claiming.py` has them taken),
`measuring` (a real run gives the costs), `predicting` (a run here, foretold and compared), `growing` (more and more
workers, and what bends first), `pricing` (what 1,000 frames cost), `pictures`.

**Conventions.** Times are float seconds since the simulation began; sizes bytes; rates per second.
"""
