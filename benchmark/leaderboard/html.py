"""The board and the studies as Markdown and as HTML pages that open from a file, without a network."""

import functools
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from benchmark.leaderboard import labels
from benchmark.leaderboard.instructions_table import instructions_view
from benchmark.leaderboard.views import board_view, studies_view

if TYPE_CHECKING:
    from jinja2 import Environment

BOARD, STUDIES = "leaderboard", "studies"


def render_html(board: Mapping[str, Any]) -> str:
    """Returns the page of the entries of what :func:`benchmark.leaderboard.build.build` returned."""
    return _render("leaderboard.html.j2", board_view(board))


def render_markdown(board: Mapping[str, Any]) -> str:
    """Returns the tables of the entries as Markdown."""
    return _render("leaderboard.md.j2", board_view(board))


def render_studies_html(board: Mapping[str, Any]) -> str:
    """Returns the page of everything that is no entry: other budgets, ablations, foreign checkpoints."""
    return _render("studies.html.j2", studies_view(board))


def render_studies_markdown(board: Mapping[str, Any]) -> str:
    """Returns the tables of the studies as Markdown."""
    return _render("studies.md.j2", studies_view(board))


def render_instructions_html(board: Mapping[str, Any]) -> str:
    """Returns the page of instruction tests."""
    return _render("instructions.html.j2", instructions_view(board["instructions"], board["latest"]))


def render_instructions_markdown(board: Mapping[str, Any]) -> str:
    """Returns the tables of instruction tests as Markdown."""
    return _render("instructions.md.j2", instructions_view(board["instructions"], board["latest"]))


def _render(template: str, view: Mapping[str, Any]) -> str:
    environment = _environment(is_html=template.endswith(".html.j2"))
    return environment.get_template(template).render(levels=labels.LEVELS, **view)


@functools.cache
def _environment(is_html: bool) -> "Environment":
    """Returns where templates are kept: compiling them takes longer than a small board."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("benchmark"),
        autoescape=is_html,
        finalize=None if is_html else labels.markdown,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters |= labels.FILTERS
    return environment
