"""GC tuning: the process runs garbage collection rarely from the import of this module on.

**Conventions.** A process imports this before its other modules: with Python's own thresholds, loading them took a
sixth longer. For multiprocessing's fork server, only its modules to load can be chosen.
"""

from stone_base.process_tuning import tune_command

tune_command()
