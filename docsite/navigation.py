"""Patterns in the navigation: `operations/*.md` stands for the pages that are there.

**Conventions.** A navigation is as MkDocs reads it: a list of pages, or of {title: page or list}. An index comes first,
the others by name. A page stands once: where it is named, else where the first pattern matches it.
"""

from collections.abc import Iterable
from fnmatch import fnmatchcase
from typing import Any

Nav = list[Any]


def spread(nav: Nav, pages: Iterable[str]) -> Nav:
    """The navigation with every pattern replaced by the pages it matches; a section without any page is left out."""
    named = _named(nav)
    return _spread(nav, [page for page in pages if page not in named])


def _named(nav: Nav) -> set[str]:
    """The pages that are named, not matched."""
    found: set[str] = set()
    for entry in nav:
        content = next(iter(entry.values())) if isinstance(entry, dict) else entry
        found |= _named(content) if isinstance(content, list) else {content}
    return found


def _spread(nav: Nav, left: list[str]) -> Nav:
    return [entry for given in nav for entry in _entries(given, left)]


def _entries(entry: Any, left: list[str]) -> Nav:
    if isinstance(entry, str):
        return _taken(entry, left) if "*" in entry else [entry]
    title, content = next(iter(entry.items()))
    if isinstance(content, str) and "*" not in content:
        return [entry]
    inside = _spread(content if isinstance(content, list) else [content], left)
    return [{title: inside}] if inside else []


def _taken(pattern: str, left: list[str]) -> Nav:
    """The pages that match, taken out of what is left."""
    found = [page for page in left if fnmatchcase(page, pattern)]
    left[:] = [page for page in left if page not in found]
    return sorted(found, key=lambda page: (not page.endswith("/index.md"), page))
