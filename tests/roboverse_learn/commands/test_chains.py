"""``roboverse evaluate suite=calvin chains=…``: labels, images and words of chains of instructions."""

import json
import shutil

import pytest

import policies
from benchmark import calvin_chains
from benchmark.calvin_chains import ChainScores
from benchmark.chain_results import ChainResults, read_runs
from envs.core.errors import ConfigError
from envs.core.git import git_sha
from roboverse_learn import api, cli
from roboverse_learn.commands import chains
from roboverse_learn.config.compose import compose
from tests.policies.examples import CONFIGS, FEATURES, IMAGE, SIZE, stats

WORDS = ["evaluate", "policy=expert", "suite=calvin"]


@pytest.fixture
def ran(monkeypatch):
    """The chains that were run, without an environment; each ends with its index modulo 6."""
    ran = []

    def evaluate(_policy, _make_env, indices, results: ChainResults) -> ChainScores:
        for index in indices:
            if index not in results.done:
                ran.append(index)
                results.add(index, index % 6)
        return ChainScores(
            tuple(results.done[index] for index in indices), (("open_drawer",) * 5,) * len(indices)
        )

    monkeypatch.setattr(calvin_chains, "evaluate_chains", evaluate)
    return ran


def saved_policy(folder, seed=0):
    """Saves a policy that reads, of CALVIN's two cameras at a size that is neither's."""
    names = ("observation.images.static", "observation.images.gripper")
    features = {key: value for key, value in FEATURES.items() if key != IMAGE}
    features |= dict.fromkeys(names, FEATURES[IMAGE])
    own_stats = stats() | dict.fromkeys(names, stats()[IMAGE])
    policies.create("mtact", features, own_stats, CONFIGS["mtact"], seed=seed).save(folder)
    return folder


def test_results_say_by_which_command_commit_and_seed_they_were_made(ran, tmp_path, capsys):
    out = f"results_dir={tmp_path}"
    for _ in range(2):
        assert cli.main([*WORDS, "chains=2", out]) == 0
    assert cli.main([*WORDS, "chains=1", "first_chain=7", out]) == 0
    assert "Average successful sequence length: 1.000 (1 chains)" in capsys.readouterr().out
    assert ran == [0, 1, 7]
    first, second = read_runs(tmp_path / chains.FILE)["expert"]
    folder = f"results_dir=.../{tmp_path.name}"
    assert first["command"] == f"roboverse evaluate policy=expert suite=calvin chains=2 {folder}"
    assert first["solved"] == {"0": 0, "1": 1} and second["solved"] == {"7": 1}
    assert first["git_sha"] == git_sha() and first["seed"] == 0


def test_a_checkpoint_with_other_weights_or_another_view_is_run_anew(ran, tmp_path):
    folder = saved_policy(tmp_path / "policy" / "pretrained")
    words = ["evaluate", f"checkpoint={folder}", "suite=calvin", "other_tasks=true", "device=cpu"]
    results = tmp_path / "results"
    words += ["chains=2", f"results_dir={results}"]
    for _ in range(2):
        assert cli.main(words) == 0
    assert ran == [0, 1]
    assert cli.main([*words, "task_kwargs.qpos_noise_rad=0.02"]) == 0
    assert ran == [0, 1] * 2
    shutil.rmtree(folder)
    saved_policy(folder, seed=1)
    assert cli.main([*words]) == 0
    assert ran == [0, 1] * 3
    assert len(read_runs(results / chains.FILE)) == 3
    assert str(tmp_path) not in (results / chains.FILE).read_text(), "results are published"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["suite=calvin", "chains=2000"], "from 1 to 1,000, given 2,000, first_chain=0"),
        (["suite=calvin", "chains=2", "first_chain=999"], "from 1 to 1, given 2, first_chain=999"),
        (["suite=calvin", "first_chain=3"], "first_chain=3 needs chains"),
        (["suite=paper", "chains=2"], "give chains=2 suite=calvin"),
        (["task=PickCube", "chains=2"], "give chains=2 suite=calvin"),
        (["suite=calvin", "chains=2", "episodes=5"], "leave evaluate.episodes or chains out"),
    ],
)
def test_what_chains_cannot_be_is_refused(words, said):
    with pytest.raises(ConfigError, match=said):
        compose("evaluate", ["policy=expert", *words])


def test_a_program_is_told_where_scores_of_chains_are(tmp_path):
    with pytest.raises(ConfigError, match="roboverse evaluate suite=calvin chains"):
        api.evaluate("expert", suite="calvin", chains=1, results_dir=str(tmp_path))


@pytest.mark.slow
def test_a_policy_that_reads_sees_the_images_of_its_training_and_is_asked_each_instruction(
    tmp_path, monkeypatch
):
    seen = []

    def keep(policy, make_env, indices, results):
        made = make_env(1)
        seen.extend([made.camera_names, made.scenario.cameras[0].height])
        make_env = lambda _: made  # noqa: E731
        return evaluate_chains(policy, make_env, indices, results)

    evaluate_chains = calvin_chains.evaluate_chains
    monkeypatch.setattr(calvin_chains, "evaluate_chains", keep)
    monkeypatch.setattr(calvin_chains, "STEPS_PER_TASK", 6)
    folder = saved_policy(tmp_path / "policy" / "pretrained")
    words = [f"checkpoint={folder}", "suite=calvin", "other_tasks=true", "device=cpu", "chains=1"]
    assert cli.main(["evaluate", *words, f"results_dir={tmp_path / 'results'}"]) == 0
    assert seen == [("static", "gripper"), SIZE]
    (runs,) = json.loads((tmp_path / "results" / chains.FILE).read_text()).values()
    assert runs[0]["solved"] == {"0": 0}
