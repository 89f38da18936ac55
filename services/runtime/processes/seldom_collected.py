"""Makes a process look for garbage seldom on import, for one that can be told only which modules to load."""

from stone_base.garbage import collect_seldom

collect_seldom()
