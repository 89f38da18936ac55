"""Makes the process collect garbage rarely, from its import on.

**Conventions.** A process imports this before its other modules: loading them cost a sixth more with Python's own
thresholds. Of multiprocessing's fork server only the modules that it loads can be chosen.
"""

from stone_base.process_tuning import tune_command

tune_command()
