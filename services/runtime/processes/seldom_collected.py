"""Tunes a fork server on import, since only the modules that it loads can be chosen."""

from stone_base.process_tuning import tune_command

tune_command()
