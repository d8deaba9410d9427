"""Samples with a wrong instruction: whose they are, what holding still is, and what stays as it was."""

from dataclasses import replace

import numpy as np
import pytest
import torch

import policies
from envs.core.errors import PolicyError
from policies.learned_tasks import LAST, UNRELATED, ZERO, Instructions, LearnedTask
from tests.policies.examples import FEATURES, stats
from tests.policies.mtact.examples import CONFIG, HEADS, frames, loss_of, make, with_film

WIDE = LearnedTask(name="Wide", state_size=9, action_size=9, still=(3, ZERO, LAST, *range(6)))
NARROW = LearnedTask(name="Narrow", state_size=7, action_size=5, still=(0, 6, ZERO, ZERO, LAST))
ASKED = Instructions(
    texts=("lift the red cube", "raise the red cube", "open the drawer", "walk the maze", "sweep the stairs"),
    tasks=(WIDE, NARROW),
    task_of=(0, 0, 1, UNRELATED, UNRELATED),
    wrong=((2, 3, 4), (0, 1, 4)),
)
HALF = replace(CONFIG, wrong_instructions=0.5)


def batch_of(policy, indices=(0, 1, 2, 2)) -> dict[str, torch.Tensor]:
    """Returns frames with the action before the chunk, which a policy with wrong instructions asks for."""
    batch, before = frames(indices), len(policy.delta_indices["action"]) - CONFIG.chunk_size
    draw = torch.Generator().manual_seed(5)
    first = torch.randn(len(indices), before, 9, generator=draw)
    batch["action"] = torch.cat([first, batch["action"]], 1)
    batch["action_is_pad"] = torch.zeros(batch["action"].shape[:2], dtype=torch.bool)
    return batch


def learned(policy, batch, seed: int = 0):
    """Returns what the network is trained on in a batch: its instructions and normalized actions."""
    seen, network = {}, policy.model.model

    def errors(inputs, actions, is_own):
        seen.update(actions=actions, is_own=is_own, language=inputs["observation.language"])
        return original(inputs, actions, is_own)

    original, network.errors = network.errors, errors
    with torch.no_grad():
        seen["loss"] = loss_of(policy, batch, seed)
    del network.errors
    seen["text"] = [
        int((policy.model.table.language == row).flatten(1).all(1).nonzero()[0, 0])
        for row in seen["language"]
    ]
    return seen


def certainly(policy, is_wrong, drawn):
    """Replaces the draw by a given one."""
    policy.model.wrong.draw = lambda task: (torch.tensor(is_wrong), torch.tensor(drawn))


def test_a_wrong_sample_holds_still_and_a_right_one_is_as_demonstrated():
    policy = make(HALF, ASKED)
    batch = batch_of(policy)
    certainly(policy, [True, False, True, False], [3, 3, 0, 0])
    found = learned(policy, batch)
    assert found["text"] == [3, 1, 0, 2]
    own = stats()
    mean, std = (np.asarray(own["action"][name], np.float32) for name in ("mean", "std"))
    actions = found["actions"].numpy() * (std + 1e-8) + mean
    state, last = batch["observation.state"].numpy(), batch["action"][:, 0].numpy()
    wide = [state[0, 3], 0.0, last[0, 2], *state[0, :6]]
    narrow = [state[2, 0], state[2, 6], 0.0, 0.0, last[2, 4]]
    assert actions.shape == (4, CONFIG.chunk_size, 9)
    np.testing.assert_allclose(actions[0], [wide] * CONFIG.chunk_size, atol=1e-5)
    np.testing.assert_allclose(actions[2, :, :5], [narrow] * CONFIG.chunk_size, atol=1e-5)
    np.testing.assert_allclose(actions[[1, 3]], batch["action"][[1, 3], 1:], atol=1e-5)
    assert found["is_own"].sum(1).tolist() == [9, 9, 5, 5]


def test_the_state_that_is_held_has_no_noise():
    policy = make(replace(HALF, state_noise=0.5), ASKED)
    certainly(policy, [True] * 4, [3, 3, 0, 0])
    quiet = make(HALF, ASKED)
    certainly(quiet, [True] * 4, [3, 3, 0, 0])
    assert learned(policy, batch_of(policy))["actions"].equal(learned(quiet, batch_of(quiet))["actions"])


def test_each_task_gets_its_wrong_instructions_and_both_kinds_as_often():
    wrong = make(HALF, ASKED).model.wrong
    torch.manual_seed(0)
    task = torch.tensor([0, 1]).repeat_interleave(8000)
    is_wrong, drawn = wrong.draw(task)
    assert is_wrong.float().mean().item() == pytest.approx(0.5, abs=0.01)
    for number, expected in enumerate(([0, 0, 0.5, 0.25, 0.25], [0.25, 0.25, 0, 0, 0.5])):
        found = torch.bincount(drawn[task == number], minlength=5) / 8000
        np.testing.assert_allclose(found, expected, atol=0.02)
        assert not found[torch.tensor(expected) == 0].any()


def test_a_task_without_wrong_instructions_has_right_ones_alone():
    wrong = make(HALF, replace(ASKED, wrong=((2,), ()))).model.wrong
    is_wrong, drawn = wrong.draw(torch.tensor([0, 1]).repeat_interleave(100))
    assert is_wrong[:100].any() and not is_wrong[100:].any()
    assert drawn[:100].eq(2).all()
    unknown = replace(ASKED, tasks=(replace(WIDE, still=()), NARROW))
    assert not make(HALF, unknown).model.wrong.draw(torch.zeros(100, dtype=torch.int64))[0].any()


def test_a_share_of_zero_draws_and_reads_what_it_did_before_the_setting():
    policy = with_film(make(replace(CONFIG, swap_wordings=True, state_noise=0.1), ASKED))
    assert policy.model.wrong is None
    assert policy.delta_indices == {"action": list(range(CONFIG.chunk_size))}
    policy.begin_training()
    loss, after = loss_of(policy, frames()).item(), torch.rand(1)
    torch.manual_seed(0)
    torch.randn(4, 9)  # noise of the states, and an order of the five wordings for each of four samples
    torch.rand(4, 5)
    assert torch.rand(1) == after
    assert loss_of(policy, frames()).item() == loss


@HEADS
def test_the_same_seed_draws_the_same(head):
    policy = with_film(make(replace(HALF, head=head), ASKED))
    policy.begin_training()
    first, again, other = (learned(policy, batch_of(policy), seed) for seed in (3, 3, 4))
    assert first["text"] == again["text"] and first["actions"].equal(again["actions"])
    assert first["loss"] == again["loss"] != other["loss"]


def test_losses_of_tasks_are_of_right_samples_and_still_ones_have_their_own():
    policy = make(HALF, ASKED)
    certainly(policy, [True, False, True, False], [3, 3, 0, 0])
    batch = batch_of(policy)
    with torch.no_grad():
        loss, terms = policy.objective()(batch)
        certainly(policy, [False] * 4, [0] * 4)
        right = policy.objective()(batch)[1]
        certainly(policy, [True, True, True, True], [3, 3, 0, 0])
        still = policy.objective()(batch)[1]["l1_loss/still"]
    assert set(terms) == {"l1_loss", "l1_loss/Wide", "l1_loss/Narrow", "l1_loss/still"}
    parts = terms["l1_loss/Wide"] + terms["l1_loss/Narrow"] + 2 * terms["l1_loss/still"]
    torch.testing.assert_close(loss, parts / 4)
    assert right["l1_loss/still"] == 0.0 and still > 0.0
    assert right["l1_loss/Wide"] != terms["l1_loss/Wide"]  # whose first sample is not in it any more


def test_after_the_end_of_an_episode_a_sample_still_holds_still():
    policy = make(replace(HALF, mask_padding=True), ASKED)
    batch = batch_of(policy, (0, 0))
    batch["action_is_pad"][:, 1:] = True
    for is_wrong, counts in ((True, True), (False, False)):
        certainly(policy, [is_wrong] * 2, [3, 3])
        assert bool(learned(policy, batch)["loss"] > 0) == counts


def test_a_checkpoint_is_one_without_the_setting(tmp_path):
    policy = make(HALF, ASKED)
    assert policy.state_dict().keys() == make(CONFIG, ASKED).state_dict().keys()
    policy.save(tmp_path)
    assert policies.load(tmp_path).delta_indices == {"action": list(range(CONFIG.chunk_size))}


def test_a_policy_without_a_dataset_can_be_timed():
    policy = policies.create("mtact", FEATURES, stats(), HALF)
    batch = batch_of(policy, (0, 0, 0, 0))
    assert torch.isfinite(loss_of(policy, batch))


@pytest.mark.slow
@HEADS
def test_the_loss_is_one_graph_of_static_shapes(head):
    policy = make(replace(HALF, head=head), ASKED)
    policy.begin_training()
    objective, batch = policy.objective(), batch_of(policy)
    eager = loss_of(policy, batch)
    objective.compile(fullgraph=True, dynamic=False, backend="eager")
    torch.manual_seed(0)
    torch.testing.assert_close(objective(batch)[0], eager, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("share", [-0.1, 1.0])
def test_a_share_outside_zero_to_one_is_refused(share):
    with pytest.raises(PolicyError, match=r"policy\.wrong_instructions must be"):
        replace(CONFIG, wrong_instructions=share)
