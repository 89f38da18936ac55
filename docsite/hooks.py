"""What MkDocs calls while it builds the site: patterns of the navigation become pages, pages are made of the code.

**Conventions.** The functions' names are MkDocs' events. Made pages are in memory only, never in `docs/`.
"""

from collections.abc import Mapping
from functools import cache
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

from docsite.navigation import spread
from docsite.pages import made_pages


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Spread the patterns of the navigation over what is in `docs/` and what is made."""
    folder = Path(config.docs_dir)
    written = {path.relative_to(folder).as_posix() for path in folder.rglob("*.md")}
    config.nav = spread(config.nav or [], sorted({*written, *_made()}))
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the made pages."""
    for name, content in _made().items():
        files.append(File.generated(config, name, content=content))
    return files


@cache
def _made() -> Mapping[str, str]:
    return made_pages()
