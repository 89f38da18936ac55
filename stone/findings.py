"""Findings about an input, by the name that the science and the platform know them by (`stone_base/findings.py`)."""

from stone_base.findings import Finding, Severity

__all__ = ["Finding", "Severity"]
