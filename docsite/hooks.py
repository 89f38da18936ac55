"""What MkDocs calls while it builds the site: pages are made of the code.

**Conventions.** The functions' names are MkDocs' events. Made pages are in memory only, never in `docs/`.
"""

from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

from docsite.pages import made_pages

SEARCH_SHIM = Path(__file__).resolve().parents[1] / "web" / "node_modules" / "iframe-worker" / "shim" / "index.js"
"""Stands in for the worker of the search where the site is opened from a folder: browsers start none there."""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the made pages, and what the search needs without a server."""
    files.append(File.generated(config, "javascripts/iframe-worker.js", abs_src_path=str(SEARCH_SHIM)))
    for name, content in made_pages().items():
        files.append(File.generated(config, name, content=content))
    return files
