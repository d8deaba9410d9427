"""The page of simulators and renderers says what the registry and the classes say."""

import json
from pathlib import Path

import pytest

from docs.generate import simulators_page as page
from envs.core.errors import MissingExtraError, UnknownNameError
from envs.core.extras import checkout_command
from envs.simulators import HANDLERS, RENDERERS

DOCS = Path(__file__).parents[2] / "docs"


def test_the_page_in_the_docs_is_what_the_registry_gives():
    speeds = json.loads((DOCS / "simulators.json").read_text())
    expected = page.page(speeds)
    assert (DOCS / "simulators.md").read_text() == expected, "run: python -m docs.generate.simulators_page"


def test_every_simulator_and_renderer_has_a_row_with_its_install_line():
    text = page.page({})
    for registry in (HANDLERS, RENDERERS):
        for name in registry:
            extra = registry.entry(name).extra
            (row, *_) = [line for line in text.splitlines() if line.startswith(f"| `{name}` |")]
            assert row.endswith("| not measured |")
            assert (f"`{checkout_command(extra)}`" if extra else "with the package") in row


@pytest.mark.parametrize("name", RENDERERS.names())
def test_what_a_renderer_cannot_show_is_what_it_says_of_itself(name):
    try:
        renderer = RENDERERS.get(name)
    except MissingExtraError as error:
        pytest.skip(str(error))
    assert RENDERERS.entry(name).info.get("cannot", "") == ", ".join(renderer.not_shown)


def test_speeds_are_multiples_of_the_defaults():
    speeds = {"control_step_ms": {"mujoco": 2.0, "newton": 7.0}, "image_ms": {"warp": 10.0, "gl": 5.0}}
    rows = {line.split("`")[1]: line for line in page.page(speeds).splitlines() if line.startswith("| `")}
    assert rows["newton"].endswith(("| 3.5 × |", "| not measured |"))
    assert "| 3.5 × |" in page.page(speeds)
    assert rows["gl"].endswith("| 0.5 × |")


def test_a_speed_is_measured_and_kept_beside_the_page(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(page, "control_step_ms", lambda name: 1.0 + len(name))
    monkeypatch.setattr(page, "image_ms", lambda name: 2.0)
    out = tmp_path / "simulators.md"
    assert page.main([f"out={out}", "measure=[mujoco, warp]"]) == 0
    assert json.loads(out.with_suffix(".json").read_text()) == {
        "control_step_ms": {"mujoco": 7.0},
        "image_ms": {"warp": 2.0},
    }
    assert page.main([f"out={out}", "measure=[mujocco]"]) == 2
    assert "Did you mean 'mujoco'?" in capsys.readouterr().err
    with pytest.raises(UnknownNameError, match="Unknown simulator 'wrap'"):
        page.measure(["wrap"], {})
