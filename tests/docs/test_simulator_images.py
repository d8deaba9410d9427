"""One scene in several renderers, side by side."""

import logging

import numpy as np
import pytest
from PIL import Image

from docs.generate import simulator_images as gallery
from envs.core.errors import SimulatorError
from envs.simulators import HANDLERS, RENDERERS


def test_every_renderer_is_listed_once():
    found = gallery.names("mujoco")
    assert found[:3] == ["warp", "gl", "filament"]
    assert set(found) == {*RENDERERS, *HANDLERS} - {"mujoco"}
    assert len(found) == len(set(found))


@pytest.mark.slow
def test_a_row_is_the_scene_at_two_levels_its_depth_and_its_parts(tmp_path):
    path = tmp_path / "renderers.png"
    words = [f"out={path}", "image_size=32", "renderers=[warp, mujoco_warp]"]
    assert gallery.main(words) == 0
    with Image.open(path) as image:
        sheet = np.asarray(image).astype(int)
    band = 32 + 4 + 18
    assert sheet.shape == (2 * band + 4, 4 * 36 + 4, 3)
    first, second = (
        [sheet[top : top + 32, 4 + 36 * i :][:, :32] for i in range(4)] for top in (22, 22 + band)
    )
    for one, other in zip(first, second, strict=True):
        assert one.std() > 5  # something is there
        assert np.abs(one - other).mean() < 2  # and both draw it
    assert np.abs(first[0] - first[1]).mean() > 5  # levels differ


@pytest.mark.slow
def test_what_cannot_run_is_left_out_and_named(monkeypatch, caplog):
    original = gallery._row

    def row(task, renderer, simulator, image_size):
        if renderer == "gl":
            raise SimulatorError("There is no OpenGL.")
        return original(task, renderer, simulator, image_size)

    monkeypatch.setattr(gallery, "_row", row)
    with caplog.at_level(logging.WARNING):
        image = gallery.draw("PickCube", ["gl", "warp"], simulator="mujoco", image_size=32)
    assert image.height == 32 + 4 + 18 + 4
    assert "Left out gl: There is no OpenGL." in caplog.text
    with pytest.raises(SimulatorError, match="None of the renderers gl can run here"):
        gallery.draw("PickCube", ["gl"], simulator="mujoco", image_size=32)


def test_mistakes_end_with_a_sentence(tmp_path, capsys):
    assert gallery.main(["task=PickCub", f"out={tmp_path / 'a.png'}"]) == 2
    assert "Did you mean 'PickCube'?" in capsys.readouterr().err
    assert gallery.main(["renderers=[wrap]", f"out={tmp_path / 'a.png'}"]) == 2
    assert "Unknown renderer 'wrap'. Did you mean 'warp'?" in capsys.readouterr().err


def test_depth_and_segmentation_have_distinct_colours():
    grey = gallery.shaded(np.array([[0.0, 0.3, 3.0, 9.0]]))
    assert grey[0, :, 0].tolist() == [0, 229, 0, 0]
    colours = gallery.coloured(np.array([[-1, 0, 1, 2, 3]]))[0]
    assert colours[0].tolist() == [0, 0, 0]
    assert len({tuple(colour) for colour in colours.tolist()}) == 5
