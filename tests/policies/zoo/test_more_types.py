"""Types of LeRobot beside those of ``test_vla.py``: a step, a folder that moves, an episode."""

import shutil
from types import SimpleNamespace

import numpy as np
import pytest

import policies
from policies.zoo.config import LeRobotConfig
from policies.zoo.preflight import packages_of_type
from tests.policies.examples import FEATURES, generators
from tests.policies.zoo import test_vla as vla
from tests.policies.zoo import tiny, tiny_more, tiny_packages
from tests.policies.zoo.needs import needs, of_types

pytestmark = vla.LIBRARY_TEST


KEEPS_ITS_BACKBONE = ("evo1", "fastwam", "molmoact2", "wall_x", "groot")
"""Types whose checkpoint finds its backbone where it was: it carries none (docs/howto/fine_tune_a_vla.md)."""


TYPES = ("vqbet", "evo1", "eo1", "pi0_fast", "vla_jepa", "fastwam", "molmoact2", "wall_x", "groot")
READ_INSTRUCTIONS = ("pi0_fast", "vla_jepa", "fastwam", "molmoact2", "wall_x", "groot")
FIXED_IN_CODE = tiny_more.FIXED_IN_CODE | tiny_packages.FIXED_IN_CODE


@pytest.fixture(scope="module", params=of_types(*TYPES))
def trained(request, tmp_path_factory):
    """A policy after three steps, and its checkpoint, which moved."""
    name, folder = request.param, tmp_path_factory.mktemp(request.param)
    with pytest.MonkeyPatch.context() as patch:
        module = tiny_packages if hasattr(tiny_packages, name) else tiny_more
        settings = getattr(module, name)(folder / "backbone")
        if name in FIXED_IN_CODE:
            FIXED_IN_CODE[name](patch, folder / "backbone")
        policy = vla.create(type=name, settings=settings)
        losses = vla.step(policy, count=3)
        policy.save(folder / "run" / "pretrained_model")
        if name not in KEEPS_ITS_BACKBONE:
            for path in [path for path in folder.iterdir() if path.name.startswith("backbone")]:
                shutil.move(path, folder / f"gone_{path.name}")
        shutil.move(folder / "run", folder / "moved")
        checkpoint = folder / "moved" / "pretrained_model"
        yield SimpleNamespace(name=name, policy=policy, losses=losses, checkpoint=checkpoint)


def test_losses_are_finite_and_change(trained):
    assert np.isfinite(trained.losses).all() and len({*trained.losses}) > 1


def test_a_checkpoint_that_moved_acts_the_same(trained, tmp_path):
    seen = vla.observation(trained.policy)
    expected = trained.policy.act(seen, generators(2))
    assert expected.shape == (2, trained.policy.n_action_steps, 9) and np.isfinite(expected).all()
    loaded = policies.load(trained.checkpoint)
    np.testing.assert_array_equal(loaded.act(seen, generators(2)), expected)


def test_an_episode_is_evaluated_by_the_command(trained, tmp_path):
    result = vla.evaluate(f"policy.path={trained.checkpoint}", f"results_dir={tmp_path}")
    assert result.policy == trained.name and len(result.records) == 1


@pytest.mark.parametrize("trained", of_types(*READ_INSTRUCTIONS), indirect=True)
def test_actions_depend_on_the_instruction_and_on_no_neighbour(trained):
    policy = trained.policy
    two = policy.act(vla.observation(policy), generators(2))
    words = ("open the drawer", vla.tiny.WORDS[1])
    other = policy.act(vla.observation(policy, words=words), generators(2))
    np.testing.assert_array_equal(two[1], other[1])
    if trained.name != "pi0_fast":  # whose likeliest tokens may stay after three steps
        assert not np.array_equal(two[0], other[0])


@needs("peft")
@pytest.mark.parametrize("trained", of_types(*tiny_packages.TARGETS), indirect=True)
def test_adapters_train_alone_and_load_again(trained, tmp_path):
    vla.check_adapters(trained, tiny_packages.TARGETS[trained.name], tmp_path)


def test_fine_tuning_takes_the_statistics_of_its_dataset(trained):
    given = vla.with_quantiles()
    given["action"] = {name: value + 5 for name, value in given["action"].items()}
    config = LeRobotConfig(path=str(trained.checkpoint))
    policy = policies.create("lerobot", FEATURES, given, config)
    own = [trained.policy.preprocessor, trained.policy.postprocessor]
    pipelines = [policy.preprocessor, policy.postprocessor]
    for before, after in zip(map(statistics, own), map(statistics, pipelines), strict=True):
        np.testing.assert_allclose(after, before + 5, atol=1e-6)


@pytest.mark.parametrize("trained", of_types("groot"), indirect=True)
def test_fine_tuned_actions_have_the_width_of_the_dataset(trained):
    features, given = dict(FEATURES), vla.with_quantiles()
    features["action"] = FEATURES["action"] | {"shape": (5,)}
    given["action"] = {name: value[..., :5] for name, value in given["action"].items()}
    policy = policies.create("lerobot", features, given, LeRobotConfig(path=str(trained.checkpoint)))
    assert policy.act(vla.observation(policy), generators(2)).shape[-1] == 5


@pytest.mark.parametrize("trained", of_types("groot"), indirect=True)
def test_every_frame_begins_a_sample_where_that_is_asked_for(trained):
    path = str(trained.checkpoint)
    by_itself = len(trained.policy.delta_indices["action"]) - 1
    for given, dropped in (({}, by_itself), ({"drop_n_last_frames": 0}, 0)):
        config = LeRobotConfig(path=path, settings=given)
        assert policies.create("lerobot", FEATURES, vla.with_quantiles(), config).drop_last_frames == dropped


def statistics(pipeline) -> np.ndarray:
    """Returns the least actions that the one step of a pipeline knows which normalizes."""
    (step,) = (step for step in pipeline.steps if getattr(step, "stats", None))
    return np.asarray(step.stats["action"]["min"])


@needs(*packages_of_type("pi05"))
def test_the_main_command_trains_what_normalizes_by_quantiles(tmp_path, monkeypatch, capsys):
    from roboverse_learn import cli
    from tests.integration.main_run import TINY

    monkeypatch.chdir(tmp_path)
    settings = tiny.paligemma(tmp_path / "tokenizer") | {"tokenizer": tmp_path / "tokenizer"}
    tiny.shrink_pi(monkeypatch, "lerobot.policies.pi05.modeling_pi05")
    words = [word for word in TINY if not word.startswith(("policy", "train.", "save_every", "levels"))]
    own = [f"policy.{key}={value}" for key, value in settings.items()]
    given = ["policy=lerobot", "type=pi05", *words, "levels=[0]", "train.steps=2", "run=pi05"]
    assert cli.main(["train", *given, *own]) == 0, capsys.readouterr().err
    assert list(tmp_path.glob("results/v*/PickCube/pi05/pi05.json"))


@needs(*packages_of_type("pi05"))
def test_a_chosen_type_of_numbers_is_kept_in_fine_tuning(tmp_path, monkeypatch):
    """``policy.dtype=bfloat16`` halves the memory of weights that were published in fp32."""
    settings = tiny.paligemma(tmp_path / "tokenizer")
    tiny.shrink_pi(monkeypatch, "lerobot.policies.pi05.modeling_pi05")
    vla.create(type="pi05", settings=settings, tokenizer=str(tmp_path / "tokenizer")).save(tmp_path / "base")
    chosen = vla.create(path=str(tmp_path / "base"), settings={"dtype": "bfloat16"})
    types = {str(each.dtype) for each in chosen.model.parameters()}
    assert types == {"torch.bfloat16", "torch.float32"}  # LeRobot leaves norms and embeddings in fp32
    assert np.isfinite(vla.step(chosen)).all()
    chosen.save(tmp_path / "tuned")
    loaded = policies.load(tmp_path / "tuned")
    own = {key: value.dtype for key, value in chosen.state_dict().items()}
    assert {key: value.dtype for key, value in loaded.state_dict().items()} == own
