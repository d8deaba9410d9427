"""The multi-task policy: what the instruction and padding do, and its checkpoints."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import nn

import policies
from envs.core.errors import PolicyError
from policies.checkpoint import learned_tasks, policy_type
from policies.learned_tasks import Instructions, LearnedTask
from policies.mtact.decoders import FlowDecoder
from policies.mtact.vision import Film
from tests import imported_process
from tests.policies.examples import IMAGE, NARROW, SIZE, generators, observation
from tests.policies.mtact.examples import (
    CONFIG,
    HEADS,
    frames,
    loss_of,
    make,
    seen,
    with_film,
)
from tests.policies.test_lerobot import lerobot_chunk


@HEADS
def test_another_instruction_gives_other_actions(head):
    policy = with_film(make(replace(CONFIG, head=head)))
    one, two = (
        policy.act(seen(policy, text), generators(2)) for text in ("lift the cube", "open the drawer")
    )
    assert np.abs(one - two).max() > 1e-3


def test_the_instruction_changes_what_each_camera_sees():
    policy = with_film(make())
    backbone = policy.model.model.backbones[0]
    images = torch.rand(1, 3, SIZE, SIZE)
    found = [backbone(images, vector) for vector in (torch.zeros(1, 32), torch.ones(1, 32))]
    assert not torch.allclose(*found, atol=1e-3)


def test_film_changes_nothing_at_first_and_scales_and_shifts_by_hand():
    film, images = Film(2, 3), torch.rand(1, 3, 4, 4)
    assert film(images, torch.rand(1, 2)).equal(images)
    with torch.no_grad():
        film.linear.bias.copy_(torch.tensor([1.0, 0.0, 0.0, 0.0, 5.0, 0.0]))
    expected = images * torch.tensor([2.0, 1.0, 1.0])[:, None, None]
    expected[:, 1] += 5.0
    torch.testing.assert_close(film(images, torch.rand(1, 2)), expected)


def test_every_parameter_learns():
    policy = with_film(make(replace(CONFIG, n_decoder_layers=2)))
    policy.begin_training()
    loss_of(policy, frames()).backward()
    silent = [name for name, p in policy.model.named_parameters() if p.grad is None or not p.grad.any()]
    assert silent == []


@pytest.mark.parametrize("given", [None, "lift", ["lift"]])
def test_an_observation_without_one_instruction_per_environment_is_an_error(given):
    policy = make()
    without = observation(policy, 2) | {"task": given}
    with pytest.raises(PolicyError, match=r"needs 'task', the instructions .* list of 2, one text per env"):
        policy.act(without)


@pytest.mark.parametrize("text", ["", "never heard words: zyx", "北京", "x " * 200])
def test_any_text_can_be_acted_on(text):
    policy = make()
    assert np.isfinite(policy.act(seen(policy, text))).all()


def test_an_instruction_is_read_alike_whether_it_is_read_once_or_by_each_sample():
    policy = make()
    policy.begin_training()
    with torch.no_grad():  # four samples of three instructions, and two of them
        whole = policy.objective()(frames((0, 2, 0, 2)))[0]
        parts = [policy.objective()({k: v[:2] for k, v in frames((0, 2, 0, 2)).items()})[0]]
        parts.append(policy.objective()({k: v[2:] for k, v in frames((0, 2, 0, 2)).items()})[0])
    torch.testing.assert_close(whole, sum(parts) / 2)


def test_another_wording_is_of_the_same_task_and_each_is_as_likely():
    torch.manual_seed(0)
    table = make().model.table
    first, other = (table.reworded(torch.full((1000,), index)) for index in (1, 2))
    assert set(first.tolist()) == {0, 1} and first.float().mean().item() == pytest.approx(0.5, abs=0.05)
    assert set(other.tolist()) == {2}


def test_with_swapped_wordings_the_wording_of_a_frame_does_not_matter_and_its_task_does():
    policies_ = [with_film(make(replace(CONFIG, swap_wordings=swap))) for swap in (True, False)]
    same = []
    for policy in policies_:
        policy.begin_training()
        with torch.no_grad():
            first, second = (loss_of(policy, frames((index,) * 4)) for index in (0, 1))
            same.append(bool(first == second))
            assert loss_of(policy, frames((2,) * 4)) != first
    assert same == [True, False]


@HEADS
def test_autocast_computes_the_sentence_and_the_convolutions_alone_in_bf16(head):
    policy, seen = make(replace(CONFIG, head=head)), {}
    network = policy.model.model
    for name, module in network.named_modules():
        if isinstance(module, nn.Conv2d | nn.Linear):
            module.register_forward_hook(lambda _, __, out, name=name: seen.__setitem__(name, out.dtype))
    with torch.no_grad(), torch.autocast("cpu", torch.bfloat16):
        loss_of(policy, frames())
    kinds = {name.split(".")[0]: set() for name in seen}
    for name, dtype in seen.items():
        kinds[name.split(".")[0]].add(dtype)
    rough, exact = ({dtype} for dtype in (torch.bfloat16, torch.float32))
    assert kinds == {
        **dict.fromkeys(("sentence", "backbones"), rough),
        **dict.fromkeys(("state_token", "image_tokens", "encoder", "decoder"), exact),
    }


# --- padding ------------------------------------------------------------------------------------


@HEADS
def test_padded_actions_are_in_no_loss_and_give_no_gradient(head):
    policy = make(replace(CONFIG, head=head))
    policy.begin_training()
    batch = frames((2, 2))
    loss = loss_of(policy, batch)
    loss.backward()
    gradient = policy.model.model.decoder.action_head.weight.grad
    assert gradient[:5].abs().amax(1).min() > 0
    assert not gradient[5:].any()
    if head == "flow":
        assert not policy.model.model.decoder.action_in.weight.grad[:, 5:].any()
    changed = batch | {"action": batch["action"].clone()}
    changed["action"][..., 5:] += 100.0
    assert loss_of(policy, changed) == loss


def test_padded_joints_are_not_seen():
    policy = make()
    policy.begin_training()
    batch = frames((2, 2))
    loss = loss_of(policy, batch)
    loss.backward()
    gradient = policy.model.model.state_token.weight.grad
    assert gradient[:, :7].any() and not gradient[:, 7:].any()
    changed = batch | {"observation.state": batch["observation.state"].clone()}
    changed["observation.state"][:, 7:] += 100.0
    assert loss_of(policy, changed) == loss


def test_a_sample_counts_as_much_with_fewer_joints():
    policy = make()
    with torch.no_grad():
        wide, narrow = (loss_of(policy, frames((index,))) for index in (0, 2))
        one = frames((0,))
        both = {key: torch.cat([value, frames((2,))[key]]) for key, value in one.items()}
        loss, terms = policy.objective()(both)
    torch.testing.assert_close(loss, (wide + narrow) / 2)
    torch.testing.assert_close(terms["l1_loss/Wide"], wide)
    torch.testing.assert_close(terms["l1_loss/Narrow"], narrow)


@pytest.mark.parametrize("masked", [True, False])
def test_actions_after_the_end_count_unless_they_are_masked(masked):
    policy, batch = make(replace(CONFIG, mask_padding=masked)), frames((0, 0))
    batch["action_is_pad"][:, 3:] = True
    changed = batch | {"action": batch["action"].clone()}
    changed["action"][:, 3:] += 1.0
    with torch.no_grad():
        assert (loss_of(policy, batch) == loss_of(policy, changed)) == masked


@HEADS
def test_observations_and_actions_are_those_of_the_task_without_padding(head):
    policy = with_film(make(replace(CONFIG, head=head)))
    policy.task = "Narrow"
    narrow = seen(policy, "open the drawer")
    narrow["observation.state"] = narrow["observation.state"][:, :7]
    actions = policy.act(narrow, generators(2))
    assert actions.shape == (2, 4, 5)
    policy.task = "Wide"
    with pytest.raises(PolicyError, match=r"'observation.state' has shape \(2, 7\).*\(n, 9\)"):
        policy.act(narrow, generators(2))
    assert policy.act(seen(policy, "lift the red cube"), generators(2)).shape == (2, 4, 9)


def test_acting_sees_padded_joints_as_training_does():
    policy = with_film(make())
    batch = frames((2,))
    state = batch["observation.state"][:, :7]
    policy.task = "Narrow"
    acted = policy.act(
        {
            IMAGE: batch[IMAGE].movedim(1, -1).numpy(),
            "observation.state": state.numpy(),
            "task": ["open the drawer"],
        }
    )
    chunk = torch.from_numpy(acted)
    own = torch.cat([chunk, torch.zeros(1, 4, 4)], -1)
    batch["action"][:, :4] = own
    torch.manual_seed(0)
    with torch.no_grad():
        normal = policy.objective().normalizer(batch)
        table = policy.model.table
        inputs = normal | {
            "observation.state": normal["observation.state"] * table.is_state[2],
            "observation.language": table.language[[2]],
        }
        predicted = policy.model.model(policy.model.inputs(inputs))
    torch.testing.assert_close(predicted[:, :4, :5], normal["action"][:, :4, :5], atol=1e-4, rtol=1e-4)


# --- flow matching ------------------------------------------------------------------------------


def test_the_flow_of_a_known_velocity_reaches_the_actions():
    """With the velocity a − x₀, which is constant on straight lines, any number of steps is exact."""
    decoder = FlowDecoder(4, 3, 8, 2, 16, 1, 3)
    noise, actions = torch.randn(2, 4, 3), torch.randn(2, 4, 3)
    decoder.velocity = lambda *_: actions - noise
    torch.testing.assert_close(decoder(torch.zeros(2, 5, 8), noise), actions)
    is_own = torch.tensor([[True, True, False]] * 2)
    found = decoder(torch.zeros(2, 5, 8), noise, is_own)
    torch.testing.assert_close(found[..., :2], actions[..., :2])
    assert not found[..., 2].any()


def test_the_loss_of_flow_is_that_of_the_velocity_by_hand():
    decoder = FlowDecoder(4, 3, 8, 2, 16, 1, 3)
    memory, actions, own = torch.zeros(2, 5, 8), torch.randn(2, 4, 3), torch.ones(2, 3, dtype=torch.bool)
    given = {}

    def velocity(mixed, time, _):
        given.update(mixed=mixed, time=time)
        return torch.zeros_like(mixed)

    decoder.velocity = velocity
    torch.manual_seed(3)
    errors = decoder.errors(memory, actions, own)
    torch.manual_seed(3)
    noise, uniform = torch.randn_like(actions), torch.rand(2)
    torch.testing.assert_close(given["time"], 1 - uniform ** (2 / 3))
    time = given["time"][:, None, None]
    torch.testing.assert_close(given["mixed"], time * actions + (1 - time) * noise)
    torch.testing.assert_close(errors, (actions - noise) ** 2)


def test_times_are_more_often_noisy():
    decoder, times = FlowDecoder(1, 1, 8, 2, 16, 1, 1), []
    decoder.velocity = lambda mixed, time, _: times.append(time) or mixed
    decoder.errors(torch.zeros(20000, 1, 8), torch.zeros(20000, 1, 1), torch.ones(20000, 1, dtype=torch.bool))
    assert times[0].mean().item() == pytest.approx(0.4, abs=0.01)  # the mean of Beta(1, 1.5)
    assert times[0].min() >= 0.0 and times[0].max() <= 1.0


# --- checkpoints --------------------------------------------------------------------------------


@HEADS
def test_a_moved_checkpoint_acts_the_same_and_names_its_tasks(head, tmp_path):
    policy = with_film(make(replace(CONFIG, head=head)))
    policy.save(tmp_path / "here")
    shutil.move(tmp_path / "here", tmp_path / "there")
    loaded = policies.load(tmp_path / "there")
    assert policy_type(tmp_path / "there") == loaded.name == "mtact"
    assert learned_tasks(tmp_path / "there") == ("Wide", "Narrow")
    for task, size in (("Wide", 9), ("Narrow", 7)):
        policy.task = loaded.task = task
        now = seen(policy, "a wording of no dataset")
        now["observation.state"] = now["observation.state"][:, :size]
        np.testing.assert_array_equal(loaded.act(now, generators(2)), policy.act(now, generators(2)))


def test_lerobot_acts_the_same_from_a_checkpoint(tmp_path):
    policy = with_film(make())
    policy.save(tmp_path)
    now = observation(policy, 1)
    np.testing.assert_allclose(policy.act(now), lerobot_chunk(tmp_path, now), atol=1e-5)


def test_lerobot_pads_the_joints_of_a_narrow_task(tmp_path):
    policy = with_film(make())
    policy.save(tmp_path)
    now = seen(policy, "open the drawer", 1)
    now["observation.state"], now["task"] = now["observation.state"][:, :7], np.array(now["task"])
    policy.task = "Narrow"
    np.testing.assert_allclose(policy.act(now), lerobot_chunk(tmp_path, now)[..., :5], atol=1e-5)


def test_lerobots_loss_is_ours_of_one_task():
    task = LearnedTask(name="", state_size=9, action_size=9)
    policy = make(instructions=Instructions(texts=("lift the cube",), tasks=(task,), task_of=(0,)))
    batch = frames((0, 0, 0))
    images = {IMAGE: batch[IMAGE].float() / 255}
    theirs, terms = policy.model(policy.preprocessor({**batch, **images, "task": ["lift the cube"] * 3}))
    torch.testing.assert_close(theirs, loss_of(policy, batch))
    assert terms == {"l1_loss": pytest.approx(theirs.item())}


def test_the_configuration_of_a_checkpoint_has_no_table_of_instructions(tmp_path):
    make().save(tmp_path)
    names = set(make().state_dict())
    assert not any("table." in name and "sentence" not in name for name in names)
    content = json.loads((tmp_path / "config.json").read_text())
    assert content["tasks"] == {"Wide": {"state": 9, "action": 9}, "Narrow": {"state": 7, "action": 5}}


def test_a_resnet_takes_the_place_of_the_keypoint_network():
    policy = with_film(make(replace(CONFIG, vision_backbone=NARROW)))
    policy.begin_training()
    loss_of(policy, frames()).backward()
    policy.end_training()
    one, two = (policy.act(seen(policy, text)) for text in ("lift the cube", "open the drawer"))
    assert np.abs(one - two).max() > 1e-3


@pytest.mark.slow
def test_lerobots_commands_get_the_processor_step_with_the_policy_type():
    code = (
        "import policies.mtact.configuration_multitask_act\n"
        "from lerobot.processor import ProcessorStepRegistry\n"
        "ProcessorStepRegistry.get('mtact_inputs')\n"
    )
    done = imported_process.run(code)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
@HEADS
def test_the_loss_is_one_graph_of_static_shapes(head):
    """``fullgraph`` raises where Python would have to step in, which a recording could not hold."""
    policy = make(replace(CONFIG, head=head))
    policy.begin_training()
    objective = policy.objective()
    eager = loss_of(policy, frames())
    objective.compile(fullgraph=True, dynamic=False, backend="eager")
    torch.manual_seed(0)
    torch.testing.assert_close(objective(frames())[0], eager, rtol=1e-5, atol=1e-6)
    other = frames((2, 2, 0, 1), seed=1)
    torch.manual_seed(0)
    torch.testing.assert_close(objective(other)[0], loss_of(policy, other), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ({"n_action_steps": 7}, r"policy\.n_action_steps=7 must be from 1 to policy\.chunk_size=6"),
        (
            {"dim_model": 33},
            r"dim_model=33 must be an even multiple of policy\.n_heads=2, such as 32",
        ),
        ({"conv_channels": (12,)}, r"policy\.conv_channels=\[12\] must be multiples of 8"),
        ({"head": "mixture"}, r"policy\.head must be regression or flow, given 'mixture'"),
        ({"num_inference_steps": 0}, r"policy\.num_inference_steps must be at least 1, given 0"),
        ({"num_buckets": 1}, r"policy\.num_buckets must be at least 2, given 1"),
        ({"word_dropout": 1.0}, r"policy\.word_dropout must be below 1"),
        ({"sentence_noise": -1.0}, r"policy\.sentence_noise must be 0 or more, given -1"),
        ({"word_dropout": -0.1}, r"policy\.word_dropout must be 0 or more, given -0\.1"),
        ({"state_noise": float("nan")}, r"policy\.state_noise must be 0 or more, given nan"),
        ({"text_encoder": ""}, r"policy\.text_encoder must be scratch or the folder"),
    ],
)
def test_a_wrong_setting_is_refused(setting, said):
    with pytest.raises(PolicyError, match=said):
        replace(CONFIG, **setting)


def test_a_folder_without_a_model_is_refused(tmp_path):
    with pytest.raises(PolicyError, match=r"policy\.text_encoder=.* is no folder of a model .*Give scratch"):
        make(replace(CONFIG, text_encoder=str(tmp_path)))
