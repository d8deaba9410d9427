"""Lazy images: rendered once, at the first access; otherwise a plain dict."""

import copy
import pickle

import numpy as np
import pytest

from envs.lazy_images import LazyPixels

IMAGES = {"front": np.zeros((2, 2, 3), np.uint8), "wrist": np.ones((2, 2, 3), np.uint8)}


@pytest.fixture
def lazy():
    """Lazy pixels that count how often they are rendered."""

    def draw():
        draw.calls += 1
        return {name: image.copy() for name, image in IMAGES.items()}

    draw.calls = 0
    pixels = LazyPixels(IMAGES, draw)
    return pixels, draw


@pytest.mark.parametrize(
    "look",
    [
        list,
        len,
        tuple,
        lambda p: "front" in p,
        lambda p: p.keys(),
        lambda p: bool(p),
        lambda p: p.get("nose"),
    ],
    ids=["list", "len", "tuple", "in", "keys", "bool", "get another"],
)
def test_names_are_known_without_drawing(lazy, look):
    pixels, draw = lazy
    look(pixels)
    assert not pixels.drawn
    assert draw.calls == 0


@pytest.mark.parametrize(
    "look",
    [
        lambda p: p["front"],
        lambda p: p.get("front"),
        lambda p: list(p.values()),
        lambda p: list(p.items()),
        lambda p: p.copy(),
        lambda p: dict(p.items()),
        copy.copy,
        copy.deepcopy,
        pickle.dumps,
        repr,
    ],
    ids=["item", "get", "values", "items", "copy", "dict", "copy.copy", "deepcopy", "pickle", "repr"],
)
def test_first_access_renders_all_once(lazy, look):
    pixels, draw = lazy
    look(pixels)
    look(pixels)
    assert pixels.drawn
    assert draw.calls == 1
    np.testing.assert_array_equal(pixels["wrist"], IMAGES["wrist"])


def take(**images):
    return images


@pytest.mark.parametrize(
    "read",
    [
        dict,
        lambda p: {**p},
        lambda p: take(**p),
        lambda p: p | {},
        lambda p: {} | p,
        lambda p: {camera: p.pop(camera) for camera in list(p)},
        lambda p: {camera: p.setdefault(camera, 0) for camera in p},
    ],
    ids=["dict", "**", "call", "or", "of another", "pop", "setdefault"],
)
def test_what_is_made_of_it_has_its_images(lazy, read):
    made = read(lazy[0])
    assert list(made) == list(IMAGES)
    for camera, image in IMAGES.items():
        np.testing.assert_array_equal(made[camera], image)


@pytest.mark.parametrize("change", [lambda p: p.update(front=7), lambda p: p.__setitem__("front", 7)])
def test_an_image_that_is_replaced_before_the_first_access_stays_replaced(lazy, change):
    pixels, _ = lazy
    change(pixels)
    assert pixels["front"] == 7
    np.testing.assert_array_equal(pixels["wrist"], IMAGES["wrist"])


def test_its_text_has_the_images(lazy):
    assert repr(lazy[0]) == repr(IMAGES)


def test_a_camera_that_is_not_there_is_an_ordinary_mistake(lazy):
    pixels, draw = lazy
    with pytest.raises(KeyError, match="nose"):
        pixels["nose"]
    assert pixels.get("nose") is None
    assert pixels.get("nose", 7) == 7
    assert draw.calls == 0


def test_copies_are_rendered_and_independent(lazy):
    pixels, _ = lazy
    deep, shallow = copy.deepcopy(pixels), pixels.copy()
    assert type(deep) is LazyPixels, "Gymnasium's checker compares the types of a copy and of the next"
    assert deep.drawn
    assert type(shallow) is dict
    deep["front"][:] = 9
    assert pixels["front"].max() == 0
    assert shallow["front"] is pixels["front"]


def test_it_travels_as_a_plain_dict(lazy):
    pixels, _ = lazy
    other = pickle.loads(pickle.dumps(pixels))
    assert type(other) is dict
    np.testing.assert_array_equal(other["wrist"], IMAGES["wrist"])


def test_comparison_renders_and_compares():
    pixels = LazyPixels(["front"], lambda: {"front": 3})
    assert pixels == {"front": 3}
    assert pixels != {"front": 4}
    assert not LazyPixels(["front"], lambda: {"front": 3}) != {"front": 3}  # noqa: SIM202


def test_images_are_equal_by_their_pixels():
    def lazy(**changed):
        return LazyPixels(IMAGES, lambda: {name: image.copy() for name, image in (IMAGES | changed).items()})

    plain = {name: image.copy() for name, image in IMAGES.items()}
    for same in (lazy(), plain, IMAGES):
        assert lazy() == same and same == lazy()
        assert not lazy() != same and not same != lazy()  # noqa: SIM202
    for other in (lazy(front=IMAGES["wrist"]), lazy(front=IMAGES["front"][:1]), plain | {"front": None}):
        assert lazy() != other and other != lazy()
        assert not lazy() == other  # noqa: SIM201


@pytest.mark.parametrize("other", [None, 7, {}, {"front": None}], ids=str)
def test_what_has_other_cameras_differs_without_drawing(lazy, other):
    pixels, draw = lazy
    assert pixels != other and other != pixels
    assert draw.calls == 0


def test_it_cannot_be_hashed(lazy):
    with pytest.raises(TypeError, match="unhashable"):
        hash(lazy[0])


def test_failed_rendering_raises_at_every_read():
    def fail():
        raise RuntimeError("no context")

    pixels = LazyPixels(["front"], fail)
    for _ in range(2):
        with pytest.raises(RuntimeError, match="no context"):
            pixels["front"]
    assert not pixels.drawn
