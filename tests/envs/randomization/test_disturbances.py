"""What cameras do to images: against closed forms and other libraries, alike in every batch."""

import io

import numpy as np
import pytest
import torch
from PIL import Image
from scipy.ndimage import gaussian_filter

from envs.core.errors import ConfigError
from envs.randomization import disturbances
from envs.randomization.disturbances import disturb, disturb_arrays, quantization, tone_curve
from envs.scenario import SensorCfg

ALL = SensorCfg(
    exposure_ev=0.6,
    gamma=1.1,
    blur_sigma=0.01,
    motion_length=0.05,
    motion_angle_rad=0.7,
    gaussian_noise=0.05,
    shot_noise=0.1,
    jpeg_quality=20,
    noise_seed=7,
)


@pytest.fixture(scope="module")
def scene():
    """A smooth image with edges, (48, 64, 3) uint8: sizes that are no multiples of 16 come from slices."""
    y, x = np.mgrid[:48, :64] / 64.0
    image = np.stack([x, y, 0.5 + 0.5 * np.sin(9 * x)], -1)
    image[12:30, 20:40] = (0.9, 0.1, 0.2)
    return (255 * image.clip(0, 1)).astype(np.uint8)


def one(image, sensor, frame=0, camera="front"):
    return disturb_arrays(image[None], [sensor], [frame], camera)[0]


def test_no_disturbance_changes_no_image(scene):
    assert np.array_equal(one(scene, SensorCfg()), scene)
    assert disturb_arrays(scene[None], [SensorCfg(noise_seed=3)], [0], "front")[0].base is scene


def test_an_image_is_the_same_in_every_batch_on_numpy_and_torch(scene):
    others = [SensorCfg(blur_sigma=0.03), SensorCfg(), SensorCfg(motion_length=0.1, jpeg_quality=90), ALL]
    images = np.stack([np.roll(scene, 5 * i, 1) for i in range(4)])
    frames = [3, 0, 9, 4]
    together = disturb_arrays(images, others, frames, "front")
    for row in range(4):
        alone = disturb_arrays(images[row : row + 1], [others[row]], [frames[row]], "front")[0]
        assert np.array_equal(alone, together[row])
    tensors = disturb(torch.from_numpy(images.copy()), others, frames, "front")
    assert np.array_equal(tensors.numpy(), together), "bit-identical: both are one implementation"


def test_a_batch_on_a_device_is_bit_identical_to_single_images(scene, monkeypatch):
    """A GPU takes many images at once; the same code path is taken here on the CPU."""
    sensors = [ALL, SensorCfg(blur_sigma=0.03), SensorCfg(jpeg_quality=30), SensorCfg(shot_noise=0.2)]
    images = np.stack([np.roll(scene, 5 * i, 0) for i in range(4)])
    together = disturbances._disturbed(
        torch.from_numpy(images),
        sensors,
        [disturbances.noise_start(s.noise_seed, 2, "front") for s in sensors],
    )
    for image, sensor, disturbed in zip(images, sensors, together, strict=True):
        assert np.array_equal(one(image, sensor, 2), disturbed.numpy())


def test_images_that_are_given_stay_as_they_are(scene):
    before = scene.copy()
    one(scene, ALL)
    assert np.array_equal(scene, before)


def test_noise_follows_from_seed_frame_and_camera(scene):
    noisy = SensorCfg(gaussian_noise=0.1, noise_seed=3)
    first = one(scene, noisy, 5, "front")
    assert np.array_equal(first, one(scene, noisy, 5, "front"))
    for other in (
        one(scene, noisy, 6, "front"),
        one(scene, noisy, 5, "wrist"),
        one(scene, SensorCfg(gaussian_noise=0.1, noise_seed=4), 5, "front"),
    ):
        difference = (first.astype(float) - scene).ravel(), (other.astype(float) - scene).ravel()
        assert abs(np.corrcoef(*difference)[0, 1]) < 0.05, "noise of another image is independent of it"


@pytest.mark.parametrize("level", [40, 160])
def test_noise_has_the_stated_variance(level):
    grey = np.full((128, 128, 3), level, np.uint8)
    fixed = one(grey, SensorCfg(gaussian_noise=0.04)).astype(float)
    assert fixed.mean() == pytest.approx(level, abs=0.3)
    assert fixed.std() == pytest.approx(0.04 * 255, rel=0.03)
    shots = one(grey, SensorCfg(shot_noise=0.1)).astype(float)
    assert shots.std() == pytest.approx(0.1 * 255 * np.sqrt(level / 255), rel=0.03)


def test_one_stop_doubles_the_light():
    curve = tone_curve(1.0, 1.0)
    assert curve[0] == 0.0 and curve[255] == 255.0
    assert (curve[100] / 100) ** 2.2 == pytest.approx(2.0, rel=1e-4)
    assert tone_curve(0.0, 2.0)[128] == pytest.approx(255 * (128 / 255) ** 2, rel=1e-5)


def test_a_gaussian_blur_is_scipys(scene):
    sigma = 1.5
    ours = one(scene, SensorCfg(blur_sigma=sigma / scene.shape[0]))
    theirs = gaussian_filter(scene.astype(float), (sigma, sigma, 0), mode="nearest", truncate=5 / sigma)
    assert np.abs(ours - theirs).max() <= 0.51, "rounding alone"


@pytest.mark.parametrize(("angle", "axis"), [(0.0, 1), (np.pi / 2, 0)])
def test_a_motion_spreads_a_point_along_its_direction(angle, axis):
    point = np.zeros((32, 32, 3), np.uint8)
    point[16, 16] = 255
    spread = one(point, SensorCfg(motion_length=8 / 32, motion_angle_rad=angle)).astype(float)[..., 0]
    assert (spread.sum(1 - axis) > 0).sum() == 9, "from 4 pixels on one side to 4 on the other"
    assert (spread.sum(axis) > 0).sum() == 1
    assert spread.sum() == pytest.approx(255, abs=9 * 0.5)


@pytest.mark.parametrize("quality", [10, 25, 50, 90])
def test_jpeg_is_like_that_of_a_library(scene, quality):
    """The same tables, coefficients and upsampling; a library computes in whole numbers."""
    buffer = io.BytesIO()
    Image.fromarray(scene).save(buffer, "JPEG", quality=quality, subsampling="4:2:0")
    theirs = np.asarray(Image.open(buffer)).astype(float)
    ours = one(scene, SensorCfg(jpeg_quality=quality)).astype(float)
    assert np.abs(ours - theirs).mean() < 1.6
    assert abs(np.abs(ours - scene).mean() - np.abs(theirs - scene).mean()) < 1.0, "the loss is as large"
    smooth = gaussian_filter(np.random.default_rng(0).normal(128, 300, scene.shape[:2]), 2.0)
    grey = np.repeat(smooth.clip(0, 255).astype(np.uint8)[..., None], 3, -1)
    buffer = io.BytesIO()
    Image.fromarray(grey).save(buffer, "JPEG", quality=quality, subsampling="4:2:0")
    theirs = np.asarray(Image.open(buffer)).astype(float)
    off = np.abs(one(grey, SensorCfg(jpeg_quality=quality)) - theirs)
    assert off.mean() < 0.6, "without chroma: rounding, and coefficients in the middle between two steps"


def test_quantization_tables_are_libjpegs():
    for quality in (1, 10, 49, 50, 75, 100):
        buffer = io.BytesIO()
        Image.new("RGB", (16, 16)).save(buffer, "JPEG", quality=quality)
        tables = Image.open(buffer).quantization
        for ours, theirs in zip(quantization(quality), (tables[0], tables[1]), strict=True):
            assert ours.ravel().astype(int).tolist() == list(theirs)


def test_an_image_whose_sides_are_no_multiples_of_16_keeps_its_size(scene):
    cut = scene[:37, :41]
    out = one(cut, ALL)
    assert out.shape == cut.shape and out.dtype == np.uint8


def test_disturbances_in_an_images_own_unit_look_alike_at_every_size(scene):
    large = np.repeat(np.repeat(scene, 2, 0), 2, 1)
    blur = SensorCfg(blur_sigma=0.03)
    halved = one(large, blur).astype(float).reshape(48, 2, 64, 2, 3).mean((1, 3))
    assert np.abs(halved - one(scene, blur)).mean() < 1.0


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("gamma", 0.0, "gamma must be above 0"),
        ("shot_noise", 2.0, "shot_noise is a share, 0 to 1, given 2.0"),
        ("jpeg_quality", 101, "jpeg_quality is 1 to 100, or 0"),
        ("noise_seed", -1, "noise_seed must be 0 or more, given -1"),
    ],
)
def test_values_that_no_camera_has_are_refused(field, value, words):
    with pytest.raises(ConfigError, match=words):
        SensorCfg(**{field: value})
