"""A plot is rendered only if its content differs from the existing image's."""

import pytest

from benchmark.leaderboard import plot_cache as drawn
from benchmark.leaderboard.plot_cache import draw_if_changed
from benchmark.leaderboard.plots import plot_levels, plot_losses

CELL = {"level": 0, "only": None, "split": "test", "success_rate": 0.5, "ci_low": 0.3, "ci_high": 0.7}
ROWS = [{"label": "act", "cells": [CELL]}]


class Drawing:
    """Plots into one file and returns whether it had to."""

    def __init__(self, path):
        self.path, self.calls = path, 0

    def __call__(self, rows=ROWS, title="PickCube"):
        before = self.calls
        draw_if_changed(self._draw, rows, self.path, title)
        return self.calls > before

    def _draw(self, *args, **options):
        self.calls += 1
        plot_levels(*args, **options)


@pytest.fixture
def draw(tmp_path):
    return Drawing(tmp_path / "plot.png")


def test_unchanged_plot_is_rendered_once(draw):
    assert draw()
    first = draw.path.read_bytes()
    assert not draw()
    assert draw.path.read_bytes() == first


@pytest.mark.slow
def test_changed_values_are_rendered(draw):
    assert draw()
    first = draw.path.read_bytes()
    assert draw([{"label": "act", "cells": [CELL | {"success_rate": 0.6}]}])
    assert draw.path.read_bytes() != first
    assert draw()
    assert draw.path.read_bytes() == first
    assert draw(title="StackCube")


@pytest.mark.slow
def test_missing_damaged_or_unhashed_image_is_rendered_again(draw):
    draw()
    whole = draw.path.read_bytes()
    for spoil in (
        lambda: draw.path.unlink(),
        lambda: draw.path.write_bytes(whole[: len(whole) // 2]),
        lambda: draw.path.write_bytes(b"no image"),
        lambda: plot_losses([{"step": 1, "loss": 0.5}], draw.path),
    ):
        spoil()
        assert draw()
        assert draw.path.read_bytes() == whole


def test_changed_code_renders_again(draw, monkeypatch):
    draw()
    monkeypatch.setattr(drawn, "_code", lambda _: "of another release")
    assert draw()
