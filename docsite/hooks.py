"""What MkDocs calls while it builds the site: pages are made of the code.

**Conventions.** The functions' names are MkDocs' events. Made pages are in memory only, never in `docs/`.
"""

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

from docsite.pages import made_pages


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the made pages."""
    for name, content in made_pages().items():
        files.append(File.generated(config, name, content=content))
    return files
