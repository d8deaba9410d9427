import numpy as np
import pytest
from PIL import Image

import envs
from docs.generate import level_images as gallery
from envs.core.errors import ConfigError
from envs.randomization.materials import MaterialLibrary
from envs.spec import EnvSpec


def test_images_are_laid_out_in_captioned_rows():
    red, blue = (np.full((10, 20, 3), color, dtype=np.uint8) for color in ((255, 0, 0), (0, 0, 255)))
    sheet = np.asarray(gallery.contact_sheet({"first": [red, blue], "\0second": [blue]}))
    assert (sheet == (255, 0, 0)).all(axis=-1).sum() == 200
    assert (sheet == (0, 0, 255)).all(axis=-1).sum() == 400


def test_command_line_renders_a_folder(tmp_path):
    for i in range(3):
        Image.new("RGB", (8, 8), (200, 10 * i, 0)).save(tmp_path / f"{i}.png")
    out = tmp_path / "images" / "materials.png"
    assert gallery.main([f"materials={out}", f"folder={tmp_path}"]) == 0
    with Image.open(out) as image:
        assert image.size == (3 * 68 + 4, 3 * (64 + 4 + 18) + 4)
    assert [entry.name for entry in out.parent.iterdir()] == ["materials.png"]


def test_a_bad_folder_exits_2_and_writes_nothing(tmp_path, capsys):
    assert gallery.main([f"materials={tmp_path / 'a.png'}", f"folder={tmp_path / 'none'}"]) == 2
    assert "No folder of materials" in capsys.readouterr().err
    assert not (tmp_path / "a.png").exists()


def test_a_name_that_is_not_an_image_is_an_error(tmp_path):
    with pytest.raises(ConfigError, match=r"An image's name ends in .png, .jpg or .webp, given '.*.txt'"):
        gallery.save(Image.new("RGB", (4, 4)), tmp_path / "levels.txt")


class OneColorEnv:
    """Shows one colour for each level, brighter with each episode."""

    split_indices = np.array([4, 9, 11, 20])

    def __init__(self, task, num_envs, **kwargs):
        assert (task, num_envs) == ("PickCube", 1)
        self.kwargs, self.closed = kwargs, False

    def reset_envs(self, env_ids, episodes):
        row = self.kwargs.get("level", gallery.AXES.index(self.kwargs.get("only", gallery.AXES[0])))
        self.color = (40 * row, int(episodes[0]), 0)

    def observe(self, env_ids):
        size = self.kwargs["image_size"]
        image = np.full((len(env_ids), size, size, 3), self.color, dtype=np.uint8)
        return {"observation.state": np.zeros((1, 9)), "observation.images.front": image}

    def close(self):
        self.closed = True


def test_levels_are_rows_and_episodes_columns(monkeypatch, tmp_path):
    made = []

    def make_vec(*args, **kwargs):
        made.append(OneColorEnv(*args, **kwargs))
        return made[-1]

    monkeypatch.setattr(envs, "make_vec", make_vec, raising=False)
    out = tmp_path / "levels.png"
    assert gallery.main([f"out={out}", "draws=3", "image_size=16", "split=test"]) == 0
    assert [env.kwargs["level"] for env in made] == [0, 1, 2, 3]
    assert all(env.closed and env.kwargs["split"] == "test" for env in made)
    sheet = np.asarray(Image.open(out))
    colors = {tuple(color) for color in sheet.reshape(-1, 3).tolist()}
    assert {(40 * level, episode, 0) for level in range(4) for episode in (4, 9, 11)} <= colors


def test_axes_are_rows_too(monkeypatch, tmp_path):
    made = []

    def make_vec(*args, **kwargs):
        made.append(OneColorEnv(*args, **kwargs))
        return made[-1]

    monkeypatch.setattr(envs, "make_vec", make_vec, raising=False)
    out = tmp_path / "axes.png"
    assert gallery.main([f"axes={out}", "draws=2", "image_size=16"]) == 0
    assert [env.kwargs["only"] for env in made] == list(gallery.AXES)
    colors = {tuple(color) for color in np.asarray(Image.open(out)).reshape(-1, 3).tolist()}
    assert {(40 * row, 9, 0) for row in range(len(gallery.AXES))} <= colors


def test_starts_of_several_environments_are_side_by_side_and_each_is_closed(monkeypatch):
    made = []

    def make(spec, num_envs, **kwargs):
        made.append(OneColorEnv(spec.task, num_envs, level=spec.level, image_size=spec.image_size, **kwargs))
        return made[-1]

    monkeypatch.setattr(EnvSpec, "make", make)
    specs = [EnvSpec(task="PickCube", level=level, image_size=16) for level in (1, 3)]
    image = gallery.starts(specs, split="test", index=2)
    assert image.shape == (16, 32, 3) and all(env.closed and env.kwargs["split"] == "test" for env in made)
    assert (image[:, :16] == (40, 11, 0)).all() and (image[:, 16:] == (120, 11, 0)).all()


def test_nothing_to_draw_is_a_usage_error(capsys):
    assert gallery.main([]) == 2
    assert "give out=<file>, axes=<file>, materials=<file>, or several" in capsys.readouterr().err


def test_the_built_in_sheet_shows_every_material():
    library = MaterialLibrary.built_in()
    few = MaterialLibrary({surface: names[:5] for surface, names in library.names.items()})
    assert gallery.draw_materials(few, per_row=3, image_size=16).size == (3 * 20 + 4, 6 * 20 + 3 * 18 + 4)
