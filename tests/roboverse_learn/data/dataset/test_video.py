"""Encoding and decoding: the right frame in the right row, whatever the length, the GOP and the order."""

import tempfile
from pathlib import Path

import av
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from envs.core.errors import ConfigError, DatasetError
from roboverse_learn.data import EncoderConfig, make_features
from roboverse_learn.data.dataset.video import decode_video, encode_video

FPS = 20
TOLERANCE = 6  # 8-bit limited-range YUV and a quantizer of 20


def numbered(length, height=16, width=32):
    """Frames that encode their number: by grey level, and by the place of a bright column."""
    images = np.empty((length, height, width, 3), np.uint8)
    for index, image in enumerate(images):
        image[:] = 16 + 9 * (index % 17)
        image[:, 2 * (index % 8) : 2 * (index % 8) + 2] = 235
    return images


def decode(content, rows, length, height=16, width=32, frames=None):
    """Decodes ``frames`` (all by default) into the given rows."""
    out = np.zeros((length, 3, height, width), np.uint8)
    frames = np.arange(length) if frames is None else np.asarray(frames)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "video.mp4"
        path.write_bytes(content)
        decode_video(path, frames / FPS, np.asarray(rows), out)
    return out


def key_frames(content, folder):
    (folder / "keys.mp4").write_bytes(content)
    with av.open(str(folder / "keys.mp4")) as container:
        packets = [packet for packet in container.demux(video=0) if packet.size]
    return [index for index, packet in enumerate(packets) if packet.is_keyframe]


@given(length=st.integers(1, 19), gop=st.integers(1, 8), data=st.data())
@settings(max_examples=40, deadline=None)
def test_every_frame_is_decoded_to_its_row(length, gop, data):
    images = numbered(length)
    rows = data.draw(st.permutations(range(length)))
    out = decode(encode_video(images, FPS, EncoderConfig(gop_size=gop)), rows, length)
    error = np.abs(out[rows].transpose(0, 2, 3, 1).astype(int) - images)
    assert error.mean(axis=(1, 2, 3)).max() < TOLERANCE


@given(length=st.integers(2, 15), preset=st.sampled_from(["ultrafast", "veryfast", "medium"]), data=st.data())
@settings(max_examples=20, deadline=None)
def test_chosen_frames_leave_the_other_rows_alone(length, preset, data):
    """Slower presets reorder frames in the file (B-frames); presentation times put them right."""
    images = numbered(length)
    chosen = sorted(data.draw(st.sets(st.integers(0, length - 1), min_size=1)))
    content = encode_video(images, FPS, EncoderConfig(preset=preset, gop_size=5))
    out = decode(content, chosen, length, frames=chosen)
    others = np.setdiff1d(np.arange(length), chosen)
    assert not out[others].any()
    error = np.abs(out[chosen].transpose(0, 2, 3, 1).astype(int) - images[chosen])
    assert error.mean(axis=(1, 2, 3)).max() < TOLERANCE


@pytest.mark.parametrize("gop", [1, 2, 5])
def test_key_frames_are_never_further_apart_than_the_gop(gop, tmp_path):
    keys = key_frames(encode_video(numbered(13), FPS, EncoderConfig(gop_size=gop)), tmp_path)
    assert keys[0] == 0
    assert np.diff([*keys, 13]).max() <= gop


def test_the_same_frames_give_the_same_bytes():
    images = numbered(7)
    assert encode_video(images, FPS, EncoderConfig()) == encode_video(images.copy(), FPS, EncoderConfig())
    reversed_twice = images[::-1].copy()[::-1]  # not contiguous
    assert encode_video(reversed_twice, FPS, EncoderConfig()) == encode_video(images, FPS, EncoderConfig())


def test_a_lower_crf_is_closer():
    rng = np.random.default_rng(0)
    y, x = np.mgrid[0:32, 0:32]
    images = np.stack([(128 + 90 * np.sin((x + y * k) / 5)) for k in range(4)])[..., None].repeat(3, -1)
    images = (images + rng.normal(scale=4, size=images.shape)).clip(0, 255).astype(np.uint8)
    errors = []
    for crf in (5, 20, 45):
        out = decode(encode_video(images, FPS, EncoderConfig(crf=crf)), range(4), 4, 32, 32)
        errors.append(np.abs(out.transpose(0, 2, 3, 1).astype(int) - images).mean())
    assert errors == sorted(errors) and errors[0] < 4 < errors[2]


def test_a_video_of_another_size_is_named(tmp_path):
    (tmp_path / "a.mp4").write_bytes(encode_video(numbered(3), FPS, EncoderConfig()))
    with pytest.raises(
        DatasetError, match=r"a.mp4' is truncated or damaged \(its images are 16x32, not \(8, 8\)"
    ):
        decode_video(tmp_path / "a.mp4", np.arange(3) / FPS, np.arange(3), np.zeros((3, 3, 8, 8), np.uint8))


@pytest.mark.parametrize("wanted", [[3], [0, 7], [0.5]])
def test_times_that_no_frame_has_are_an_error(tmp_path, wanted):
    (tmp_path / "a.mp4").write_bytes(encode_video(numbered(3), FPS, EncoderConfig()))
    with pytest.raises(DatasetError, match=rf"it holds 3 frames and lacks some of the {len(wanted)} wanted"):
        decode_video(
            tmp_path / "a.mp4",
            np.array(wanted) / FPS,
            np.arange(len(wanted)),
            np.zeros((2, 3, 16, 32), np.uint8),
        )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"preset": "fastest"}, "Unknown x264 preset 'fastest'. Valid: ultrafast, superfast"),
        ({"crf": 52}, "crf must be from 0 to 51, given 52"),
        ({"gop_size": 0}, "gop_size must be at least 1, given 0"),
    ],
)
def test_encoder_settings_are_checked(changes, message):
    with pytest.raises(ConfigError, match=message):
        EncoderConfig(**changes)


@pytest.mark.parametrize("size", [(33, 32), (32, 1), (0, 32)])
def test_odd_images_are_refused_before_anything_is_collected(size):
    with pytest.raises(
        DatasetError, match=rf"Camera 'front' has the image size {size[0]}x{size[1]}; video needs"
    ):
        make_features(["q"], ["u"], {"front": size})
