"""Scoring: confusions, the metrics read from them, their uncertainty, the ranking."""
