"""All generated pages, by their path in the site."""

from collections.abc import Mapping

from docsite.api_pages import api_pages
from docsite.codes_page import codes_page
from docsite.commands_page import commands_page
from docsite.programs_page import programs_page
from docsite.readmes import included_pages
from docsite.sdk_page import sdk_page
from docsite.settings_page import settings_page
from stone.scoring.metric import METRICS


def made_pages() -> Mapping[str, str]:
    """Return the generated pages as Markdown by path."""
    metrics = {f"reference/{version}.md": f"{metric.definition}\n" for version, metric in METRICS.items()}
    return {
        "reference/commands.md": commands_page(),
        "reference/sdk.md": sdk_page(),
        "reference/configuration.md": settings_page(),
        "reference/codes.md": codes_page(),
        "reference/programs.md": programs_page(),
        **included_pages(),
        **api_pages(),
        **metrics,
    }
