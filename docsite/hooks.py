"""Hooks of MkDocs that add the generated pages.

**Conventions.** The functions' names are MkDocs' events. Generated pages are in memory only, never in `docs/`.
"""

from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

from docsite.pages import made_pages

SEARCH_SHIM = Path(__file__).resolve().parents[1] / "web" / "node_modules" / "iframe-worker" / "shim" / "index.js"
"""Replaces the search worker if the site is opened from a folder, because browsers start no worker there."""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages, and the files of a search without a server."""
    files.append(File.generated(config, "javascripts/iframe-worker.js", abs_src_path=str(SEARCH_SHIM)))
    for name, content in made_pages().items():
        files.append(File.generated(config, name, content=content))
    return files
