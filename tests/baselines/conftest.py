"""Tests of models run where torch is: `make test-baselines`. Elsewhere none is collected."""

from importlib.util import find_spec

collect_ignore_glob = [] if find_spec("torch") else ["test_*.py", "*/test_*.py"]
