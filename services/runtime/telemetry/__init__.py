"""Telemetry: tracing spans, counters, and request ids in log lines.

Read in this order: `tracing` (OpenTelemetry's spans, and links between a person's acts), `origins` (the request and
span of a row). Then `counters` (the counts of a process), `counter_rows` (counts on their way to `/metrics`),
`platform_status` (the status at each scrape).

**Conventions.** Telemetry decides nothing, and its failures never make work fail. Attributes and labels are ids, kinds,
states, codes and numbers; never a name, a user's text, an exception's message or a credential.
"""
