"""What the platform tells of itself: spans, counts, and what ties a line of a log to the request that caused it.

Read in this order: `tracing` (spans, when OpenTelemetry is switched on), `origins` (what a row remembers of the request
that made it), `stories` (what links one act of a person to the next), `meters` and `tallies` (what a process counts),
`tally_rows` (the way of counts to whoever answers `/metrics`), `standing` (how things are when it is asked).

**Conventions.** Nothing here decides anything, and nothing that fails here makes work fail. Attributes and labels are
ids, kinds, states, codes and numbers; never a name, a word of a user, a sentence of an exception or a credential.
"""
