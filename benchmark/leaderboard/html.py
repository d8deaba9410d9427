"""The leaderboard as Markdown and as one HTML page that opens from a file, without server or network."""

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any

from benchmark.leaderboard.curve_chart import curve_charts
from benchmark.leaderboard.row_style import row_style
from benchmark.learning_curves import published_times

LEVELS = {
    0: ("object poses", "Only the task space varies: where objects and goals are."),
    1: ("+ materials", "Table, walls and ground get other materials, too."),
    2: ("+ camera", "The camera looks from another of 59 poses, too."),
    3: ("+ light", "Lights, their colour, and how surfaces reflect vary, too."),
}
"""Channel that each level adds, for the head of its column."""

_WIDTH, _HEIGHT = 560, 300
_LEFT, _RIGHT, _TOP, _BOTTOM = 44, 16, 14, 40


def render_html(board: Mapping[str, Any]) -> str:
    """Returns the page of a leaderboard that :func:`benchmark.leaderboard.build` made."""
    return _render("leaderboard.html.j2", board)


def render_markdown(board: Mapping[str, Any]) -> str:
    """Returns the tables of a leaderboard as Markdown."""
    return _render("leaderboard.md.j2", board)


def _render(template: str, board: Mapping[str, Any]) -> str:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    is_html = template.endswith(".html.j2")
    environment = Environment(
        loader=PackageLoader("benchmark"),
        autoescape=is_html,
        finalize=None if is_html else _markdown,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters |= {
        "percent": _percent,
        "interval": _interval,
        "p_value": _p_value,
        "from_to": _from_to,
    }
    sections = [section | _layout(section, board["reference"]) for section in board["sections"]]
    return environment.get_template(template).render(
        sections=sections,
        overview=board["overview"],
        reference=board["reference"],
        levels=LEVELS,
        row_style=row_style,
    )


def _markdown(value: Any) -> Any:
    """Escapes HTML, which Markdown passes through, and what would end a cell of a table."""
    if not isinstance(value, str):
        return value
    return escape(" ".join(value.splitlines()), quote=False).replace("|", "\\|")


def _from_to(counts: Iterable[int]) -> str:
    """Returns what counts lie between: ``4 to 6``, or ``6`` where all are the same."""
    ordered = sorted(set(counts))
    return " to ".join(str(count) for count in dict.fromkeys((ordered[0], ordered[-1])))


def _percent(rate: float) -> str:
    return f"{100 * rate:.0f}"


def _interval(cell: Mapping[str, Any]) -> str:
    return f"{_percent(cell['ci_low'])}–{_percent(cell['ci_high'])}"


def _p_value(value: float) -> str:
    return "< 0.001" if value < 0.001 else f"{value:.3f}"


def _layout(section: Mapping[str, Any], reference: Mapping[str, Any]) -> dict[str, Any]:
    """Returns what the templates need beside a section: its columns, cells by column, and its chart."""
    cells = [cell for row in section["rows"] for cell in row["cells"]]
    levels = sorted({cell["level"] for cell in cells if cell["level"] is not None})
    alone = sorted({cell["only"] for cell in cells if cell["only"] is not None})
    columns = [{"level": level, "only": None} for level in levels]
    columns += [{"level": None, "only": only} for only in alone]
    grids = [[_find(row["cells"], column) for column in columns] for row in section["rows"]]
    papers = [row for row in reference["rows"] if row["task"] == section["task"]]
    hidden = sorted({name for cell in cells for name in cell["not_shown"]})
    pairs: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for test in section["comparisons"]:
        pairs.setdefault((test["a"], test["b"]), []).append(test)
    return {
        "columns": columns,
        "pairs": [(*names, [_at(tests, column) for column in columns]) for names, tests in pairs.items()],
        "grids": grids,
        "papers": papers,
        "hidden": hidden,
        "chart": _chart(section["rows"], levels),
        "learning": curve_charts(
            section["task"], section["curves"], ends_when_solved=bool(section["ends_when_solved"])
        ),
        "times": published_times(section["task"]),
        "iqm": any(row["iqm_test"] for row in section["rows"]),
    }


def _find(cells: Sequence[Mapping[str, Any]], column: Mapping[str, Any]) -> dict[str, Any]:
    """Returns a column's cell of either split, None where it was not evaluated."""
    return {
        split: _at([cell for cell in cells if cell["split"] == split], column) for split in ("test", "train")
    }


def _at(items: Sequence[Mapping[str, Any]], column: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """Returns the item of a column's level or channel, None when there is none."""
    matching = (i for i in items if i["level"] == column["level"] and i["only"] == column["only"])
    return next(matching, None)


def _chart(rows: Sequence[Mapping[str, Any]], levels: Sequence[int]) -> dict[str, Any] | None:
    """Returns the coordinates of the level curves, or None when there is nothing to join."""
    if len(levels) < 2:
        return None
    step = min(10.0, 80.0 / max(1, len(rows) - 1))  # else the intervals of several policies hide each other
    spread = step * (len(rows) - 1)

    def x(level: int, index: int) -> float:
        inner = _WIDTH - _LEFT - _RIGHT - spread - 60
        shift = step * index - spread / 2
        return round(_LEFT + 30 + spread / 2 + inner * levels.index(level) / (len(levels) - 1) + shift, 1)

    def y(rate: float) -> float:
        return round(_TOP + (1 - rate) * (_HEIGHT - _TOP - _BOTTOM), 1)

    curves = []
    for index, row in enumerate(rows):
        points: dict[str, list[dict[str, float]]] = {"test": [], "train": []}
        for cell in row["cells"]:
            if cell["level"] is not None:
                ends = {"low": y(cell["ci_low"]), "high": y(cell["ci_high"])}
                points[cell["split"]].append(
                    {"x": x(cell["level"], index), "y": y(cell["success_rate"])} | ends
                )
        curves.append({"label": row["label"], "style": row_style(index), **points})
    return {
        "width": _WIDTH,
        "height": _HEIGHT,
        "left": _LEFT,
        "right": _WIDTH - _RIGHT,
        "bottom": _HEIGHT - _BOTTOM,
        "ticks": [{"y": y(rate / 100), "text": f"{rate} %"} for rate in (0, 25, 50, 75, 100)],
        "levels": [{"level": level, "x": round(x(level, 0) + spread / 2, 1)} for level in levels],
        "curves": curves,
    }
