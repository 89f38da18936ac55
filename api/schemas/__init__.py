"""Request and response bodies of the API, one module per noun, each with an example.

**Conventions.** A `…Body` is a request: unknown keys are refused, text is bounded and plain (no control characters).
Every other model is a response: times are ISO 8601 UTC and end in `_at`, ids are 32 hex digits, sizes end in `_bytes`;
a sensor's `stamp_ns` stays integer nanoseconds.
"""
