"""The GIF of one of CALVIN's chains."""

import numpy as np
from PIL import Image, ImageSequence

from docs.generate import calvin_gif
from docs.generate.calvin_gif import CAPTION_PX, Shot, frames
from envs.tasks import TASKS
from envs.tasks.calvin.sequences import all_chains
from envs.tasks.calvin.starts import protocol_state
from envs.tasks.calvin.task import CalvinTask


def shots():
    task = TASKS.get("calvin/D/open_drawer")()
    assert isinstance(task, CalvinTask)
    states = [protocol_state(task.scenario, [all_chains()[index][0]]) for index in (0, 1)]
    return [Shot(states[0], "open"), Shot(states[0], "close"), Shot(states[1], "close")]


def test_a_frame_shows_its_scene_and_its_instruction():
    first, other_words, other_scene = (np.array(frame) for frame in frames(shots(), 64))
    assert first.shape == (64 + CAPTION_PX, 64, 3)
    np.testing.assert_array_equal(first[:64], other_words[:64])
    assert (first[64:] != other_words[64:]).any() and (first[64:].min() < 128)
    assert (other_words[:64] != other_scene[:64]).any()
    np.testing.assert_array_equal(other_words[64:], other_scene[64:])


def test_no_policy_is_an_error_that_says_which(capsys, tmp_path):
    out = tmp_path / "chain.gif"
    assert calvin_gif.main([f"out={out}"]) == 2 and not out.exists()
    assert "checkpoint=<run folder of recipe=mtact_calvin>" in capsys.readouterr().err


def test_the_page_shows_a_chain_of_five_instructions():
    with Image.open(calvin_gif.ChainSettings().out) as gif:
        captions = {
            frame.convert("L").crop((0, 320, 320, 352)).tobytes() for frame in ImageSequence.Iterator(gif)
        }
    assert len(captions) == 5
