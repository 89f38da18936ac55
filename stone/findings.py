"""Findings about an input, re-exported from `stone_base/findings.py`."""

from stone_base.findings import Finding, Severity

__all__ = ["Finding", "Severity"]
