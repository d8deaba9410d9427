"""Materials: the same bytes everywhere, no seams, no two alike, and fast errors for people."""

import hashlib
import os
import subprocess
import sys

import numpy as np
import pytest

from envs.core.errors import ConfigError, UnknownNameError
from envs.randomization import procedural
from envs.randomization.procedural.layouts import basket, courses, herringbone
from envs.randomization.procedural.noise import Stream, cells, fractal, grain, interpolate, noise

ONE_OF_EACH_FAMILY = tuple(f"{family}-007" for family in procedural.FAMILIES)

# A changed texture changes what published results saw. If the change is meant, raise
# procedural.VERSION, freeze the next split version, and put the new digest here.
DIGEST_OF_ONE_OF_EACH_FAMILY = "f812e1933bbbaadfcc097ddfdf742bbb856d74ae7fd2a73c6c3a7d4bb1f5aef3"

DIGEST_SCRIPT = """
import hashlib, sys
from envs.randomization import procedural
sha = hashlib.sha256()
for name in sys.argv[1:]:
    sha.update(procedural.texture(name).tobytes())
sys.stdout.write(sha.hexdigest())
"""


@pytest.fixture(scope="module")
def library() -> dict[str, np.ndarray]:
    procedural.texture.cache_clear()
    return {
        name: procedural.texture(name) for surface in range(3) for name in procedural.surface_names(surface)
    }


def test_the_library_has_300_table_150_wall_and_150_ground_materials_and_shares_none():
    names = [procedural.surface_names(surface) for surface in range(3)]
    assert [len(surface) for surface in names] == [300, 150, 150]
    assert len(set().union(*names)) == 600


@pytest.mark.slow
def test_every_material_is_an_image_of_its_own(library):
    assert all(image.shape == (256, 256, 3) and image.dtype == np.uint8 for image in library.values())
    assert len({hashlib.sha256(image.tobytes()).digest() for image in library.values()}) == 600


@pytest.mark.slow
def test_no_material_is_black_burnt_out_or_blank(library):
    for name, image in library.items():
        assert 20 < image.mean() < 245, name
        assert image.std(axis=(0, 1)).max() > 0.5, name


@pytest.mark.slow
def test_copies_side_by_side_show_no_seam(library):
    """Across the seam, neighbouring pixels differ no more than the most different ones inside."""
    for name, image in library.items():
        pixels = image.astype(np.float32)
        for axis in (0, 1):
            inside = np.abs(np.diff(pixels, axis=axis)).mean(axis=(1 - axis, 2))
            seam = np.abs(pixels.take(0, axis) - pixels.take(-1, axis)).mean()
            assert seam <= 1.6 * inside.max() + 0.5, f"{name}: axis {axis}, {seam} against {inside.max()}"


@pytest.mark.slow
def test_families_look_different_from_number_to_number(library):
    for family in ("wood", "marble", "fabric", "tiles", "bricks", "plaster"):
        means = [library[name].mean(axis=(0, 1)) for name in library if name.startswith(f"{family}-")]
        assert np.std(means, axis=0).max() > 15, family


def test_textures_are_those_that_results_were_made_with():
    sha = hashlib.sha256(b"".join(procedural.texture(name).tobytes() for name in ONE_OF_EACH_FAMILY))
    assert sha.hexdigest() == DIGEST_OF_ONE_OF_EACH_FAMILY


def test_textures_are_bit_identical_without_vector_instructions():
    from numpy._core._multiarray_umath import __cpu_dispatch__

    disabled = {"NPY_DISABLE_CPU_FEATURES": " ".join(__cpu_dispatch__), "PYTHONHASHSEED": "7"}
    result = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", DIGEST_SCRIPT, *ONE_OF_EACH_FAMILY],
        env=os.environ | disabled | {"PYTHONPATH": os.getcwd()},
        capture_output=True,
        text=True,
        check=True,
    )
    assert result.stdout == DIGEST_OF_ONE_OF_EACH_FAMILY


@pytest.mark.parametrize("size", [16, 64, 100, 128, 512])
def test_any_size_shows_the_same_material(size):
    small, native = procedural.texture("marble-003", size), procedural.texture("marble-003")
    assert small.shape == (size, size, 3)
    assert np.abs(small.mean(axis=(0, 1)) - native.mean(axis=(0, 1))).max() < 3


def test_a_smaller_size_is_the_average_of_the_native_one():
    native = procedural.texture("bricks-002", 256).astype(int)
    expected = native[:2, :2].mean(axis=(0, 1))
    assert np.abs(procedural.texture("bricks-002", 128)[0, 0] - expected).max() <= 0.5


def test_a_texture_is_read_only_because_it_is_shared():
    with pytest.raises(ValueError, match="read-only"):
        procedural.texture("wood-000")[0] = 0


def test_an_unknown_material_names_the_nearest_family():
    with pytest.raises(UnknownNameError, match=r"Unknown material family 'marbel'. Did you mean 'marble'\?"):
        procedural.texture("marbel-001")
    with pytest.raises(
        UnknownNameError, match=r"'marbel'.*A material is a family and a number: 'wood-017'\."
    ):
        procedural.texture("marbel")


@pytest.mark.parametrize("name", ["wood", "end-grain", "wood-x"])
def test_a_family_without_a_number_is_no_material(name):
    with pytest.raises(UnknownNameError, match=rf"^Material '{name}' has no number\. A material is a family"):
        procedural.texture(name)


def test_an_impossible_size_says_what_is_possible():
    with pytest.raises(ConfigError, match="A texture's size is 16 to 2048 pixels, given 4"):
        procedural.texture("wood-001", 4)


def test_a_stream_depends_on_its_key_alone():
    assert Stream("a", 1).uniform() == Stream("a", 1).uniform()
    assert len({Stream("a", 1).uniform(), Stream("a", 2).uniform(), Stream("b", 1).uniform()}) == 3
    numbers = [Stream("n", i).integer(3, 5) for i in range(200)]
    assert set(numbers) == {3, 4, 5}
    assert sorted(Stream("o").order(50)) == list(range(50))


def test_interpolation_keeps_a_constant_and_wraps_round():
    assert np.allclose(interpolate(np.full((3, 5), 0.25, dtype=np.float32), 64), 0.25)
    bump = np.zeros((8, 8), dtype=np.float32)
    bump[0, 0] = 1
    field = interpolate(bump, 64)
    assert field[0, 0] == pytest.approx(field[-1, -1], abs=0.2)
    assert field[32, 32] == 0


def test_noise_has_the_stated_spread():
    for field in (noise(Stream(1), 16, 16, 256), fractal(Stream(2), 256, rows=8, cols=8)):
        assert abs(field.mean()) < 0.1
        assert field.std() == pytest.approx(0.5, abs=0.1)
    assert np.abs(grain(Stream(3), 256)).max() <= 1


@pytest.mark.parametrize("stagger", [False, True])
def test_cells_are_those_of_the_nearest_site(stagger):
    rows = cols = 4
    first, second, nearest = cells(Stream(5), 64, rows, cols, jitter=0.8, stagger=stagger)
    stream = Stream(5)
    x = stream.array(-0.5, 0.5, rows, cols) * 0.8 + 0.5 + np.arange(cols)
    y = stream.array(-0.5, 0.5, rows, cols) * 0.8 + 0.5 + np.arange(rows)[:, None]
    if stagger:
        x[1::2] += 0.5
    pixel = (np.arange(64) + 0.5) / 16
    gaps = [np.abs(pixel[:, None] - site.ravel()[None, :] % 4) for site in (x, y)]
    gap_x, gap_y = (np.minimum(gap, 4 - gap) for gap in gaps)
    distance = np.sqrt(gap_y[:, None, :] ** 2 + gap_x[None, :, :] ** 2)
    ordered = np.sort(distance, axis=-1)
    assert np.allclose(first, ordered[..., 0], atol=1e-5)
    assert np.allclose(second, ordered[..., 1], atol=1e-5)
    assert (nearest == distance.argmin(axis=-1)).mean() > 0.999


@pytest.mark.parametrize(
    ("pieces", "expected_count", "area"),
    [
        (courses(240, 6, 2, 0.5), 12, 1 / 12),
        (basket(240, 4, 4), 64, 1 / 64),
        (herringbone(240, 3, 2), 48, 1 / 48),
    ],
    ids=["courses", "basket", "herringbone"],
)
def test_every_layout_covers_the_texture_with_equal_pieces(pieces, expected_count, area):
    numbers, sizes = np.unique(pieces.piece, return_counts=True)
    assert len(numbers) == expected_count
    assert numbers.max() < pieces.count
    assert np.allclose(sizes / 240**2, area)
    assert pieces.edge.min() >= 0
    assert pieces.along.min() >= 0 and pieces.along.max() <= 1
    assert pieces.across.min() >= 0 and pieces.across.max() <= 1
