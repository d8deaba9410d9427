"""The library, and folders of images that replace or extend it."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from envs.core.errors import ConfigError, UnknownNameError
from envs.randomization.materials import MaterialLibrary
from envs.randomization.splits import load_split
from envs.scenario import SURFACES


def save_image(path, color, size=(40, 20)):
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", size, color).save(path)


@pytest.fixture
def flat_folder(tmp_path):
    for i in range(12):
        save_image(tmp_path / f"photo{i:02d}.png", (10 * i, 100, 200))
    (tmp_path / "LICENSE").write_text("CC0")
    return tmp_path


def test_built_in_library_generates_its_own_names():
    library = MaterialLibrary.built_in()
    assert {surface: len(names) for surface, names in library.names.items()} == {
        "table": 300,
        "wall": 150,
        "ground": 150,
    }
    assert library.texture("cork-001", 64).shape == (64, 64, 3)


def test_table_textures_cover_a_plausible_part_of_the_table():
    library = MaterialLibrary.built_in()
    for surface in SURFACES:
        for name in library.names[surface]:
            low, high = library.size_range_m(name, surface)
            assert 0.5 <= low <= high <= (1.2 if surface == "table" else 2.0), name


def test_a_flat_folder_serves_every_surface_and_its_images_are_cut_square(flat_folder):
    library = MaterialLibrary.from_folder(flat_folder)
    assert all(library.names[surface] == library.names["table"] for surface in SURFACES)
    assert len(library.names["wall"]) == 12
    image = library.texture("photo03.png", 32)
    assert image.shape == (32, 32, 3)
    assert tuple(image[5, 5]) == (30, 100, 200)


def test_a_setting_names_what_is_taken_and_a_plus_adds(flat_folder):
    built_in = MaterialLibrary.built_in().names["table"]
    images = MaterialLibrary.from_folder(flat_folder).names["table"]
    taken = {
        words: MaterialLibrary.chosen(words).names["table"]
        for words in ("", str(flat_folder), f"+{flat_folder}")
    }
    assert taken == {"": built_in, str(flat_folder): images, f"+{flat_folder}": (*built_in, *images)}
    assert MaterialLibrary.chosen(None).names["table"] == built_in


def test_subfolders_replace_only_their_own_surface(tmp_path):
    for i in range(3):
        save_image(tmp_path / "wall" / f"{i}.webp", (i, i, i))
    library = MaterialLibrary.from_folder(tmp_path)
    assert library.names["wall"] == ("wall/0.webp", "wall/1.webp", "wall/2.webp")
    assert library.names["table"] == MaterialLibrary.built_in().names["table"]


def test_extending_keeps_the_built_in_materials_and_their_sides(flat_folder):
    library = MaterialLibrary.from_folder(flat_folder, extend=True)
    assert len(library.names["table"]) == 312
    for side in ("train", "test"):
        frozen = load_split(side).materials["table"]
        assert load_split(side, library).materials["table"][: len(frozen)] == frozen


def test_digest_depends_on_the_content_of_the_folder(flat_folder):
    before = MaterialLibrary.from_folder(flat_folder).digest()
    assert before == MaterialLibrary.from_folder(flat_folder).digest()
    assert before != MaterialLibrary.built_in().digest()
    save_image(flat_folder / "photo00.png", (255, 255, 255))
    assert MaterialLibrary.from_folder(flat_folder).digest() != before


def test_a_missing_folder_says_what_a_folder_looks_like(tmp_path):
    with pytest.raises(ConfigError, match=r"No folder of materials at '.*nowhere'. Give a folder with image"):
        MaterialLibrary.from_folder(tmp_path / "nowhere")


@pytest.mark.parametrize("extend", [False, True])
def test_a_folder_without_images_is_an_error(tmp_path, extend):
    (tmp_path / "notes.txt").write_text("nothing")
    with pytest.raises(ConfigError, match="holds no image"):
        MaterialLibrary.from_folder(tmp_path, extend=extend)


def test_a_broken_image_is_named(flat_folder):
    (flat_folder / "broken.png").write_bytes(b"not an image")
    with pytest.raises(ConfigError, match=r"broken.png' cannot be read as an image .* Replace or remove it"):
        MaterialLibrary.from_folder(flat_folder)


def test_truncated_image_is_named_in_the_error(tmp_path):
    pixels = np.random.default_rng(0).integers(0, 255, (64, 64, 3), dtype=np.uint8)
    for name in ("a.jpg", "b.jpg"):
        Image.fromarray(pixels).save(tmp_path / name)
    whole = (tmp_path / "b.jpg").read_bytes()
    (tmp_path / "b.jpg").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ConfigError, match=r"b.jpg' cannot be read as an image"):
        MaterialLibrary.from_folder(tmp_path).texture("b.jpg")


def test_a_name_that_is_no_image_of_the_folder_gets_a_suggestion(flat_folder):
    with pytest.raises(UnknownNameError, match=r"'foto03.png'. Did you mean 'photo03.png'\?"):
        MaterialLibrary.from_folder(flat_folder).texture("foto03.png")


def test_what_ends_as_an_image_is_one_in_the_folder_and_in_messages(tmp_path):
    save_image(tmp_path / "photo.png", (0, 0, 200))
    for name in (".png", "LOUD.PNG"):  # to pathlib the first is a name without a suffix
        shutil.copy(tmp_path / "photo.png", tmp_path / name)
    library = MaterialLibrary.from_folder(tmp_path, extend=True)
    of_folder = [".png", "LOUD.PNG", "photo.png"]
    assert [name for name in library.names["wall"] if library.is_image(name)] == of_folder
    assert library.texture(".png", 8)[0, 0].tolist() == [0, 0, 200]
    with pytest.raises(UnknownNameError, match=r"'LOUT.PNG'.* Valid: .png, LOUD.PNG, photo.png\.$"):
        library.texture("LOUT.PNG")


def test_a_message_names_an_image_that_pathlib_sees_no_suffix_of():
    library = MaterialLibrary({surface: ("wood_oak", "a.b/.png") for surface in SURFACES}, Path())
    with pytest.raises(UnknownNameError, match=r"Valid: a.b/.png\.$"):
        library.is_image("c.png")
