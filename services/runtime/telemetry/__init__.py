"""Telemetry: tracing spans, counters, and request ids in log lines.

Read in this order: `tracing` (OpenTelemetry's spans, when switched on), `origins` (what a row remembers of the request
that made it), `trace_links` (what links one act of a person to the next), `metric_names` and `counters` (what a process
counts), `counter_rows` (the way of counts to whoever answers `/metrics`), `platform_status` (how things are when it is
asked).

**Conventions.** Nothing here decides anything, and nothing that fails here makes work fail. Attributes and labels are
ids, kinds, states, codes and numbers; never a name, a word of a user, a sentence of an exception or a credential.
"""
