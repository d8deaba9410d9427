"""The frozen file, its digest, and that its sides share nothing."""

import json
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from envs.core.errors import ConfigError, UnknownNameError
from envs.randomization import splits
from envs.randomization.camera_poses import CAMERA_POSES
from envs.randomization.furniture_catalogue import LAYOUTS, PIECES
from envs.randomization.materials import MaterialLibrary
from envs.scenario import SURFACES

FROZEN = splits.FOLDER / "v2.json"
DIGEST_OF_V2 = "0cc341358cc82803e5a64e232f84c8048302a17632c959053915fd38e658d66c"


@pytest.fixture(scope="module")
def sides():
    return splits.load_split("train"), splits.load_split("test")


def test_v2_is_what_it_was_when_the_first_result_was_published(sides):
    assert {side.digest for side in sides} == {DIGEST_OF_V2}


def test_split_file_is_what_its_command_samples():
    assert splits.draw_content() == json.loads(FROZEN.read_text())


def test_every_list_is_divided_90_to_10(sides):
    train, test = sides
    assert (len(train.episodes), len(test.episodes)) == (9000, 1000)
    assert (len(train.cameras), len(test.cameras)) == (53, 6)
    assert (len(train.furniture), len(test.furniture)) == (216, 24)
    assert (len(train.layouts), len(test.layouts)) == (54, 6)
    counts = {s: (len(train.materials[s]), len(test.materials[s])) for s in SURFACES}
    assert counts == {"table": (270, 30), "wall": (135, 15), "ground": (135, 15)}


def test_the_sides_are_disjoint_and_together_everything(sides):
    train, test = sides
    assert np.array_equal(np.union1d(train.episodes, test.episodes), np.arange(10_000))
    assert not np.intersect1d(train.episodes, test.episodes).size
    assert set(train.cameras) | set(test.cameras) == set(CAMERA_POSES)
    assert not set(train.cameras) & set(test.cameras)
    for name, everything in (("furniture", PIECES), ("layouts", LAYOUTS)):
        assert sorted(getattr(train, name) + getattr(test, name)) == sorted(everything)
        assert {item.split("-")[0] for item in getattr(test, name)} == {i.split("-")[0] for i in everything}
    library = MaterialLibrary.built_in()
    for surface in SURFACES:
        assert set(train.materials[surface]) | set(test.materials[surface]) == set(library.names[surface])
    everything = [{name for names in side.materials.values() for name in names} for side in sides]
    assert not everything[0] & everything[1]


def test_membership_is_that_of_the_episodes(sides):
    train, test = sides
    first = int(test.episodes[0])
    assert first in test and first not in train
    assert -1 not in train and 10_000 not in train and 10_000 not in test


def test_episodes_cannot_be_changed(sides):
    with pytest.raises(ValueError, match="read-only"):
        sides[0].episodes[0] = 5


def test_validation_is_the_last_episodes_of_training_with_what_training_draws(sides):
    train, test = sides
    validation = splits.load_split("validation")
    assert validation.name == "validation"
    assert validation.episodes.tolist() == train.episodes[8000:].tolist()
    assert not np.intersect1d(validation.episodes, test.episodes).size
    assert int(train.episodes[0]) not in validation and int(train.episodes[-1]) in validation
    for part in ("materials", "cameras", "furniture", "layouts", "digest", "version"):
        assert getattr(validation, part) == getattr(train, part)
    assert validation.drawn.name == "train"
    assert (train.drawn, test.drawn) == (train, test)
    with pytest.raises(ValueError, match="read-only"):
        validation.episodes[0] = 5


@pytest.mark.parametrize("name", ["all", "Test", "val"])
def test_a_split_must_be_named(name):
    with pytest.raises(
        UnknownNameError, match=rf"Unknown split '{name}'.*Valid: test, train, validation. Name the split"
    ):
        splits.load_split(name)


def test_an_unknown_version_lists_the_versions():
    with pytest.raises(UnknownNameError, match=r"Unknown split version 'v9'.*Valid: v2"):
        splits.load_split("train", version="v9")


def test_a_changed_file_is_refused(tmp_path):
    content = json.loads(FROZEN.read_text())
    content["test_episodes"][0] += 1
    path = tmp_path / "v2.json"
    path.write_text(json.dumps(content))
    with pytest.raises(
        ConfigError, match=r"v2.json' was changed: its content has SHA-256 \w{64}, it says 0cc3"
    ):
        splits.read_content(path)


@pytest.mark.parametrize("text", ["", "{", "[1, 2]", '{"version": "v1"}'])
def test_a_damaged_file_is_refused_with_what_to_do(tmp_path, text):
    path = tmp_path / "v2.json"
    path.write_text(text)
    with pytest.raises(ConfigError, match="Restore the file"):
        splits.read_content(path)


def test_layout_of_the_file_does_not_matter_but_its_content_does(tmp_path):
    path = tmp_path / "v2.json"
    path.write_text(json.dumps(json.loads(FROZEN.read_text()), indent=3))
    assert splits.read_content(path) == splits.draw_content()


def test_freezing_writes_once_and_never_overwrites(tmp_path):
    path = tmp_path / "v2.json"
    assert splits.freeze(path)
    assert path.read_text() == FROZEN.read_text()
    assert not splits.freeze(path)
    other = splits.draw_content() | {"pool": 5}
    path.write_text(splits.render_content(other | {"sha256": splits.content_digest(other)}))
    with pytest.raises(ConfigError, match="is frozen, and the lists sampled now differ"):
        splits.freeze(path)
    assert json.loads(path.read_text())["pool"] == 5
    assert [entry.name for entry in tmp_path.iterdir()] == ["v2.json"]


def test_the_command_checks_the_file_and_exits_2_when_it_is_wrong(tmp_path):
    assert splits.main([]) == 0
    (tmp_path / "v2.json").write_text("{}")
    assert splits.main([f"path={tmp_path / 'v2.json'}"]) == 2


def test_hashing_divides_about_90_to_10_and_adding_an_image_moves_no_other():
    names = [f"photo{i}.png" for i in range(500)]
    before = splits.split_by_hash(names)
    assert 30 <= len(before["test"]) <= 70
    after = splits.split_by_hash([*names, "new.png"])
    for side in ("train", "test"):
        assert set(before[side]) <= set(after[side])


def test_the_same_image_is_on_one_side_on_every_surface():
    names = [f"photo{i}.png" for i in range(200)]
    table, wall = (splits.split_by_hash([f"{s}/{name}" for name in names]) for s in ("table", "wall"))
    assert [n.split("/")[1] for n in table["test"]] == [n.split("/")[1] for n in wall["test"]]


@pytest.mark.parametrize("count", [2, 3, 5])
def test_few_images_still_give_both_sides_some(count):
    divided = splits.split_by_hash([f"{i}.png" for i in range(count)])
    assert len(divided["test"]) >= 1 and len(divided["train"]) >= 1
    assert len(divided["test"]) + len(divided["train"]) == count


def test_one_image_cannot_be_split():
    with pytest.raises(ConfigError, match=r"needs at least 2 images for each surface.*given 1: a.png"):
        splits.split_by_hash(["a.png"])


def test_importing_the_package_is_light():
    code = "import sys, envs.randomization as r; r.channels_of; heavy = {'torch', 'mujoco', 'PIL', 'scipy'}; "
    code += "sys.exit(', '.join(heavy & set(sys.modules)) or None)"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr


@given(st.lists(st.from_regex(r"[a-z]{1,8}\.png", fullmatch=True), min_size=2, max_size=40, unique=True))
def test_any_images_are_divided_without_loss_and_whatever_their_order(names):
    divided = splits.split_by_hash(names)
    assert sorted(divided["train"] + divided["test"]) == sorted(names)
    assert divided["train"] and divided["test"]
    assert set(splits.split_by_hash(names[::-1])["test"]) == set(divided["test"])
