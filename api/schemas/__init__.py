"""Request and response bodies of the API, one module per noun, each with an example.

**Conventions.** A `…Body` comes in: unknown keys are refused, text is bounded and plain (no control characters). Every
other model goes out: times are ISO 8601 UTC and end in `_at`, ids are 32 hex digits, sizes end in `_bytes`; a sensor's
`stamp_ns` stays what it is, integer nanoseconds.
"""
