"""One episode, one look: deterministic, channel by channel, and never a test look in training."""

import itertools
import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from envs.core.errors import ConfigError, UnknownNameError
from envs.randomization import (
    CHANNELS,
    LEVEL_CHANNELS,
    LEVELS,
    LightingCfg,
    MaterialLibrary,
    Randomizer,
    channel_rng,
    channels_of,
)
from envs.randomization.splits import load_split
from envs.scenario import SURFACES, Appearance, CameraCfg, LightCfg, SurfaceMaterial
from envs.tasks import TASKS

BASE = Appearance(
    materials={"table": SurfaceMaterial(rgb=(0.5, 0.4, 0.3)), "ground": SurfaceMaterial(roughness=0.9)},
    lights=(LightCfg(intensity=0.7),),
)
CAMERAS = (CameraCfg(name="front", pos=(1.5, 0.0, 1.5), look_at=(0.0, 0.0, 0.0), fovy_deg=47.0),)


def make(channels, split="train", seed=0, **kwargs):
    return Randomizer(BASE, CAMERAS, channels=channels, split=split, seed=seed, **kwargs)


@pytest.fixture(scope="module")
def pool():
    """All samples of all channels, with the furniture of a room, for the whole pool, by split."""
    draws = {}
    for split in ("train", "test"):
        randomizer = make(LEVEL_CHANNELS, split, scenario=TASKS.get("PickCube")().scenario)
        draws[split] = [randomizer.draws(int(episode)) for episode in randomizer.split.episodes]
    return draws


def values(draws, channel, *keys):
    """The set of what a channel drew at a path of keys."""
    found = set()
    for draw in draws:
        value = draw[channel]
        for key in keys:
            value = value[key]
        found.add(json.dumps(value, sort_keys=True))
    return found


@pytest.mark.slow
@pytest.mark.parametrize(
    "path",
    [
        *[("environment", "textures", surface) for surface in SURFACES],
        *[("environment", "size_m", surface) for surface in SURFACES],
        ("environment", "table_yaw_rad"),
        ("environment", "layout"),
        ("environment", "furniture"),
        ("camera", "front"),
        *[("lighting", "lights", key) for key in ("azimuth_rad", "polar_rad", "distant_intensity")],
        *[
            ("lighting", "lights", key)
            for key in ("array_intensity", "radius_m", "length_m", "temperature_k")
        ],
        *[("lighting", "reflection", surface) for surface in (*SURFACES, "objects")],
    ],
    ids="-".join,
)
def test_no_test_draw_equals_a_train_draw(pool, path):
    train, test = (values(pool[split], *path) for split in ("train", "test"))
    assert not train & test


@pytest.mark.slow
def test_no_furniture_placement_is_in_both_splits(pool):
    """Piece by piece: neither a piece nor a pose is in both splits."""
    placements = {
        split: [item for draw in draws for item in draw["environment"]["furniture"]]
        for split, draws in pool.items()
    }
    assert len(placements["test"]) > 1000, "there is furniture in every test episode"
    pieces, standing = (
        {split: {of(item) for item in found} for split, found in placements.items()}
        for of in (lambda item: item["piece"], lambda item: json.dumps(item, sort_keys=True))
    )
    assert pieces["train"] == set(load_split("train").furniture)
    assert pieces["test"] == set(load_split("test").furniture)
    assert not pieces["train"] & pieces["test"]
    assert not standing["train"] & standing["test"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "task", ["PickCube", "StackCube", "CloseBox", "MoveSliderLeft", "PickChocolatePudding", "NutAssembly"]
)
def test_splits_share_no_initial_state(task):
    """In all that a state holds, of every episode of the pool."""
    rows = {}
    for split in ("train", "test"):
        rngs = [channel_rng(0, "task", int(i)) for i in load_split(split).episodes]
        flat = TASKS.get(task)().initial_state(rngs).flatten()
        numbers = np.concatenate([value.flatten(1).numpy() for value in flat.values()], axis=1)
        rows[split] = {row.tobytes() for row in numbers}
    assert (len(rows["train"]), len(rows["test"])) == (9000, 1000), "every state is sampled once"
    assert not rows["train"] & rows["test"]


@pytest.mark.slow
def test_every_material_and_camera_of_a_split_is_used(pool):
    for split, draws in pool.items():
        allowed = load_split(split)
        assert {json.loads(v) for v in values(draws, "camera", "front")} == set(allowed.cameras)
        for surface in SURFACES:
            used = {json.loads(v) for v in values(draws, "environment", "textures", surface)}
            assert used == set(allowed.materials[surface])


def test_level_0_is_exactly_the_base():
    randomizer = make(channels_of(0))
    episode = int(randomizer.split.episodes[3])
    assert randomizer.appearance(episode) is BASE
    assert randomizer.draws(episode) == {}


def test_each_level_adds_its_channel_and_keeps_samples_of_the_one_below():
    episode = int(load_split("train").episodes[17])
    looks = [make(channels_of(level)).appearance(episode) for level in LEVELS]
    draws = [make(channels_of(level)).draws(episode) for level in LEVELS]
    for below, above in itertools.pairwise(draws):
        assert below.items() <= above.items()
        assert len(above) == len(below) + 1
    textures = [{s: look.materials[s].texture for s in SURFACES} for look in looks[1:]]
    assert textures[0] == textures[1] == textures[2]
    assert looks[1].lights == looks[2].lights == BASE.lights
    assert looks[2].cameras == looks[3].cameras
    assert looks[3].object_reflection is not None and looks[2].object_reflection is None


@pytest.mark.parametrize("only", LEVEL_CHANNELS[1:])
def test_channel_samples_do_not_depend_on_other_channels(only):
    alone, together = make(channels_of(only=only), "test"), make(LEVEL_CHANNELS, "test")
    for episode in alone.split.episodes[:20]:
        assert alone.draws(int(episode)) == {only: together.draws(int(episode))[only]}


def test_the_environment_channel_leaves_reflection_lights_and_cameras_alone():
    randomizer = make(channels_of(only="environment"))
    look = randomizer.appearance(int(randomizer.split.episodes[0]))
    assert look.materials["ground"].roughness == 0.9
    assert look.materials["table"].rgb == (1.0, 1.0, 1.0)
    assert (look.lights, look.cameras, look.object_reflection) == (BASE.lights, {}, None)
    assert 0 <= look.table_yaw_rad < 2 * math.pi


def test_the_lighting_channel_leaves_colours_alone():
    randomizer = make(channels_of(only="lighting"))
    look = randomizer.appearance(int(randomizer.split.episodes[0]))
    assert look.materials["table"].rgb == (0.5, 0.4, 0.3)
    assert look.materials["table"].texture is None
    assert len(look.lights) == 7
    assert len({look.materials[s].roughness for s in SURFACES}) == 3


def test_the_camera_channel_moves_every_camera_and_nothing_else():
    second = CameraCfg(name="side", pos=(0.0, 1.0, 1.0), look_at=(0.0, 0.0, 0.1))
    randomizer = Randomizer(BASE, (*CAMERAS, second), channels=("camera",), split="train", seed=0)
    look = randomizer.appearance(int(randomizer.split.episodes[0]))
    assert look.cameras["front"].pos != CAMERAS[0].pos and look.cameras["side"].pos != second.pos
    assert look.cameras["front"].fovy_deg == 47.0 and look.cameras["side"].look_at == (0.0, 0.0, 0.1)
    assert look.materials == BASE.materials


def test_a_second_camera_does_not_shift_the_first():
    second = CameraCfg(name="side", pos=(0.0, 1.0, 1.0), look_at=(0.0, 0.0, 0.1))
    both = Randomizer(BASE, (*CAMERAS, second), channels=("camera",), split="train", seed=0)
    for episode in map(int, both.split.episodes[:20]):
        assert both.draws(episode)["camera"]["front"] == make(("camera",)).draws(episode)["camera"]["front"]


def test_an_episode_is_the_same_in_any_order_and_differs_with_the_seed():
    episodes = [int(episode) for episode in load_split("train").episodes[:5]]
    forwards, backwards = make(LEVEL_CHANNELS), make(LEVEL_CHANNELS)
    looks = {episode: forwards.appearance(episode) for episode in episodes}
    assert {episode: backwards.appearance(episode) for episode in reversed(episodes)} == looks
    assert make(LEVEL_CHANNELS, seed=1).appearance(episodes[0]) != looks[episodes[0]]


def test_channels_have_streams_of_their_own():
    first = {
        channel: channel_rng(3, channel, 7).uniform()
        for channel in (*LEVEL_CHANNELS, "a channel of the future")
    }
    assert len(set(first.values())) == 5
    assert channel_rng(3, "task", 7).uniform() == first["task"]
    assert channel_rng(3, "task", 8).uniform() != first["task"]


@pytest.mark.slow
def test_samples_are_plain_json(pool):
    draw = pool["test"][0]
    assert json.loads(json.dumps(draw)) == draw
    assert set(draw) == {"environment", "camera", "lighting"}


@pytest.mark.parametrize("episode", [-1, 10_000, "first of the other"])
def test_an_episode_of_the_other_split_is_refused(episode):
    randomizer = make(LEVEL_CHANNELS)
    episode = int(load_split("test").episodes[0]) if isinstance(episode, str) else episode
    for call in (randomizer.appearance, randomizer.draws):
        with pytest.raises(
            ConfigError, match=rf"Episode {episode} is not in the split 'train' \(v2\), which has 9"
        ):
            call(episode)


def test_an_unknown_channel_is_an_error():
    with pytest.raises(UnknownNameError, match=r"Unknown channel 'light'. Did you mean 'lighting'\?"):
        make(("task", "light"))


@pytest.mark.slow
def test_every_sampled_material_has_a_texture(pool):
    library = MaterialLibrary.built_in()
    for name in pool["test"][0]["environment"]["textures"].values():
        assert library.texture(name, 32).shape == (32, 32, 3)


def test_the_ranges_of_the_lights_can_be_set():
    randomizer = make(LEVEL_CHANNELS, lighting=LightingCfg(array_shape=(1, 2), temperature_k=(5000, 5000)))
    draw = randomizer.draws(int(randomizer.split.episodes[0]))
    assert draw["lighting"]["lights"]["temperature_k"] == 5000
    assert len(randomizer.appearance(int(randomizer.split.episodes[0])).lights) == 3


def test_a_folder_of_images_reaches_the_appearance(tmp_path):
    from PIL import Image

    for i in range(20):
        Image.new("RGB", (8, 8), (i, i, i)).save(tmp_path / f"{i}.png")
    library = MaterialLibrary.from_folder(tmp_path)
    sides = {
        split: {
            randomizer.appearance(int(episode)).materials["table"].texture
            for randomizer in [make(("environment",), split, library=library)]
            for episode in randomizer.split.episodes[:200]
        }
        for split in ("train", "test")
    }
    assert not sides["train"] & sides["test"]
    assert sides["train"] | sides["test"] == {f"{i}.png" for i in range(20)}


@given(seed=st.integers(0, 2**63), position=st.integers(0, 999))
@settings(max_examples=60, deadline=None)
def test_every_draw_of_every_seed_is_within_its_range(seed, position):
    randomizer = make(LEVEL_CHANNELS, "test", seed=seed)
    episode = int(randomizer.split.episodes[position])
    draws, look = randomizer.draws(episode), randomizer.appearance(episode)
    cfg, lights = randomizer.lighting, draws["lighting"]["lights"]
    for name in ("distant_intensity", "array_intensity", "radius_m", "length_m", "temperature_k"):
        low, high = getattr(cfg, name)
        assert low <= lights[name] <= high
    for surface in SURFACES:
        material = look.materials[surface]
        low, high = randomizer.library.size_range_m(draws["environment"]["textures"][surface], surface)
        assert low <= material.size_m <= high
        assert all(0 <= value < 1 for value in (material.roughness, material.specular, material.metallic))
    assert all(0 <= component <= 1 for light in look.lights for component in light.color)
    assert math.dist(look.cameras["front"].pos, (0, 0, 0)) == pytest.approx(1.5)


@given(index=st.integers(-5, 10_005))
@settings(max_examples=100, deadline=None)
def test_an_episode_is_of_one_split_or_of_none(index):
    sides = [index in load_split(split) for split in ("train", "test")]
    assert sum(sides) == (0 <= index < 10_000)


@pytest.mark.parametrize("name", CHANNELS.names())
def test_episodes_for_validation_are_those_of_training(name):
    task = TASKS.get("PickCube")()
    given = {"channels": ["task", name], "scenario": task.scenario, "task": task, "workspace": None}
    train, validation = (make(split=split, **given) for split in ("train", "validation"))
    episodes = validation.split.episodes[:20].tolist()
    assert [train.draws(episode) for episode in episodes] == [validation.draws(e) for e in episodes]
    assert [train.appearance(e) for e in episodes] == [validation.appearance(e) for e in episodes]
    with pytest.raises(ConfigError, match="is not in the split 'validation'"):
        validation.draws(int(train.split.episodes[0]))
