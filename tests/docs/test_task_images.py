"""The page of tasks."""

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from docs.generate import task_images as gallery
from envs.experts.counts import ExpertCount
from envs.tasks import TASKS
from envs.tasks.calvin.catalogue import task_facts
from envs.tasks.metaworld.catalogue import WORDS
from envs.tasks.pick_cube import PickCube

DOCS = Path(__file__).resolve().parents[2] / "docs"
DRAWN = [name for name in TASKS if gallery.is_drawn(TASKS.entry(name))]
COUNT = ExpertCount(500, 0.998, 60.25)


def test_docstrings_become_markdown():
    assert gallery.plain("One :class:`~envs.state.State`,\nin ``code``.\n\nTwo.") == (
        "One `envs.state.State`, in `code`.\n\nTwo."
    )


def test_options_are_the_fields_with_their_words_defaults_and_limits():
    options = gallery.options(PickCube)
    assert options["variant"].startswith("``goal`` is ManiSkill's task") and options["variant"].endswith(
        "`goal`."
    )
    half = "Half the cube's edge, m. Default: `0.02`; at least 0.008 and at most 0.036."
    assert options["cube_half_size_m"] == half
    assert gallery.options(TASKS.get("NutAssemblySquare"))["spawn_x_m"].startswith("Start range of the nuts")
    assert gallery.class_text(PickCube).startswith("Grasp a cube and hold it at the marker")
    assert "Attributes" not in gallery.class_text(PickCube)


def test_a_count_is_described_in_words():
    assert gallery.described(COUNT) == "99.8 % of 500, 60.2 steps"
    assert gallery.described(None) == "not measured"


def test_a_section_says_everything_of_a_task():
    text = gallery.section(TASKS.entry("PickCube"), COUNT)
    for words in (
        "## PickCube\n",
        "| Source | ManiSkill 3 ([arXiv:2410.00425](https://arxiv.org/abs/2410.00425); Apache-2.0) |",
        "“pick up the red cube and hold it at the green marker”<br>“move the red cube",
        "| Robot | franka; an action has 9 numbers, `joint1` to `gripper/finger_joint2` |",
        "| Horizon | 100 steps, 5 s at 20 Hz |",
        "front 256×256",
        "| Expert | 99.8 % of 500, 60.2 steps |",
        "| `task_kwargs.variant` | `goal` is ManiSkill's task",
        "![PickCube: start and success](tasks/PickCube.jpg)",
    ):
        assert words in text, words


def test_a_family_is_one_table():
    members = [TASKS.entry("PickCube"), TASKS.entry("StackCube")]
    text = gallery.family_section("Cubes", members, {"StackCube": COUNT})
    assert text.startswith("## Cubes\n\n2 tasks of ManiSkill 3 ([arXiv:2410.00425]")
    assert f"| StackCube | {TASKS.entry('StackCube').summary} | 99.8 % of 500" in text
    assert "| PickCube | grasp a 4 cm cube and hold it at the green marker | not measured |" in text
    assert text.endswith("StackCube:\n\n![StackCube: start and success](tasks/StackCube.jpg)")


@pytest.mark.slow
def test_strips_of_many_alike_are_small_and_in_their_tables():
    text = gallery.page(["DoorClose", "metaworld/assembly"])
    (row,) = [line for line in text.splitlines() if line.startswith("| metaworld/assembly | ")]
    assert row.endswith("| ![metaworld/assembly: start and end](tasks/metaworld_assembly.jpg) |")
    assert text.count("![") == 2 and "![DoorClose: start and success](tasks/DoorClose.jpg)" in text


def test_a_family_without_images_says_how_one_is_drawn():
    of_libero = gallery.page(["libero/goal/turn_on_the_stove"])
    assert (
        "Images of objects that may not be shared freely are not in this repository: `python -m "
        "docs.generate.task_images redraw=[libero/goal/turn_on_the_stove]` draws one." in of_libero
    )
    assert "steps. Images are not in this repository" in gallery.page(["calvin/A/open_drawer"])
    assert "Images are not" not in gallery.page(["calvin/D/open_drawer"])


def test_every_task_is_shown_but_those_of_libero_and_those_that_look_like_another():
    assert {f"calvin/D/{task}" for task in task_facts()} | set(f"metaworld/{name}" for name in WORDS) <= {
        *DRAWN
    }
    hidden = [TASKS.entry(name) for name in TASKS if name not in DRAWN]
    other = {entry.name.split("/")[0] for entry in hidden if "same_scene" not in entry.tags}
    assert other == {"calvin", "libero", "libero_pro"}


def test_the_page_in_the_repository_is_the_one_that_is_made():
    assert (DOCS / "tasks.md").read_text(encoding="utf-8") == gallery.page(), (
        "Make it again: python -m docs.generate.task_images"
    )


@pytest.mark.parametrize("name", DRAWN)
def test_every_task_has_a_small_image_of_its_start_and_success(name):
    path, small = DOCS / gallery.image_path(name), gallery.is_small(TASKS.entry(name))
    assert path.stat().st_size <= (gallery.SMALL_BYTES if small else gallery.MAX_BYTES)
    with Image.open(path) as image:
        width, height = image.size
        assert (width, height) in ([(256, 128)] if small else [(512, 256), (684, 256)])


def test_a_strip_is_as_good_as_fits():
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 255, (256, 512, 3), np.uint8)
    smooth = np.full((256, 512, 3), 90, np.uint8)
    assert len(gallery.encode(smooth)) < gallery.MAX_BYTES
    fine, coarse = (Image.open(io.BytesIO(gallery.encode(strip))) for strip in (smooth, noise))
    assert max(fine.quantization[0]) < max(coarse.quantization[0])


def test_only_missing_images_are_rendered(tmp_path, monkeypatch):
    drawn = []

    def draw(name, *, renderer):
        drawn.append((name, renderer))
        return np.zeros((8, 16, 3), np.uint8)

    monkeypatch.setattr(gallery, "draw_strip", draw)
    monkeypatch.setattr(gallery, "page", lambda: "# Tasks\n")
    assert gallery.main([f"out={tmp_path}"]) == 0
    assert [name for name, _ in drawn] == sorted(DRAWN)
    assert (tmp_path / "tasks.md").read_text() == "# Tasks\n"
    drawn.clear()
    assert gallery.main([f"out={tmp_path}", "redraw=[PickCube]", "renderer=gl"]) == 0
    assert drawn == [("PickCube", "gl")]


def test_an_unknown_task_exits_2_and_writes_nothing(tmp_path, capsys):
    assert gallery.main([f"out={tmp_path}", "redraw=[PickCub]"]) == 2
    assert "Unknown task 'PickCub'. Did you mean 'PickCube'?" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_strip_shows_the_start_and_the_success():
    strip = gallery.draw_strip("PickCube")
    assert strip.shape == (256, 512, 3) and strip.dtype == np.uint8
    assert (strip[:, :256] != strip[:, 256:]).any(-1).mean() > 0.05
