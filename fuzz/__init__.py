"""Coverage-guided fuzzing of everything that reads what strangers bring; `python -m fuzz`."""
