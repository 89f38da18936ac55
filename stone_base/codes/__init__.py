"""Catalogue of codes: what a finding or a failed run means, whether it harms labels, and what to do."""
