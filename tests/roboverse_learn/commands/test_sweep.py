"""``roboverse sweep``: what it makes of its words, in which order it runs, and what it says of failures."""

import sys
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from envs.core.errors import ConfigError, UnknownNameError
from envs.core.registry import PLUGINS_VARIABLE
from envs.spec import EnvSpec
from roboverse_learn import cli
from roboverse_learn.collect import dataset_folder
from roboverse_learn.config.command_line_keys import flat_keys
from roboverse_learn.config.compose import compose, values_of_key
from roboverse_learn.config.schema import CollectConfig, SweepConfig
from roboverse_learn.config.serialize import to_values
from roboverse_learn.sweep import Sweep, SweepError, make_jobs, plan, sweep

WORDS = ["policy=act,diffusion", "task=PickCube,StackCube", "level=0,3", "preset=quick"]


def at(values, key):
    for part in key.split("."):
        values = values[part]
    return values


class TestWords:
    @pytest.mark.parametrize(
        ("word", "expected"),
        [
            ("level=0,3", ["level=0", "level=3"]),
            ("seed=range(3)", ["seed=0", "seed=1", "seed=2"]),
            ("task=metaworld/box-close,PickCube", ["task=metaworld/box-close", "task=PickCube"]),
            ("cameras=[front,wrist]", ["cameras=[front,wrist]"]),
            ("cameras=[front],[front,wrist]", ["cameras=[front]", "cameras=[front,wrist]"]),
            ("runs_dir=/data/a=b/runs", ["runs_dir=/data/a=b/runs"]),
        ],
    )
    def test_argument_with_several_values_is_expanded(self, word, expected):
        assert values_of_key(word) == expected

    def test_there_is_a_run_for_every_combination(self):
        runs = plan(WORDS).runs
        got = [(c.policy_name, c.env.task, c.env.level, c.preset) for _, c in runs]
        assert len(got) == 8
        assert got[0] == ("act", "PickCube", 0, "quick")
        assert set(got) == {
            (p, t, k, "quick")
            for p in ("act", "diffusion")
            for t in ("PickCube", "StackCube")
            for k in (0, 3)
        }

    def test_a_combination_that_is_named_twice_runs_once(self):
        assert len(plan(["seed=1,1"]).runs) == 1

    def test_sweep_keys_are_separate_from_train_keys(self):
        planned = plan(["jobs_per_gpu=3", "dry_run=true", "seed=4"])
        assert (planned.config.jobs_per_gpu, planned.config.dry_run) == (3, True)
        assert [words for words, _ in planned.runs] == [("seed=4",)]

    def test_launcher_and_its_settings_are_keys_of_the_sweep(self):
        planned = plan(["launcher=slurm", "launcher_settings.partition=gpu", "seed=4"])
        assert planned.config.launcher == "slurm"
        assert planned.config.launcher_settings == {"partition": "gpu"}
        assert [words for words, _ in planned.runs] == [("seed=4",)]

    @pytest.mark.parametrize(
        ("word", "said"),
        [
            ("launcher=slrum", "Did you mean 'slurm'"),
            ("launcher_settings.partition=gpu", "Unknown setting of launcher=local"),
            ("policy=act,difusion", "Did you mean 'diffusion'"),
            ("tsk=PickCube", "Did you mean 'task'"),
            ("task=PickCube,StackCub", "Did you mean 'StackCube'"),
        ],
    )
    def test_mistake_in_any_run_is_refused_before_all(self, word, said):
        with pytest.raises(UnknownNameError, match=said):
            plan([word])

    @pytest.mark.parametrize(
        ("words", "said"),
        [
            (["seed=range(0)"], "has no run"),
            (["seed=0,1", "run=mine"], "a sweep names its runs itself"),
            (["evaluate.episodes=10,20"], r"share the folder '.*'\. Give evaluate\.episodes one value"),
            (["seed=0,1", "train.save_every=10,20"], r"Give train\.save_every one value"),
        ],
    )
    def test_what_gives_no_run_or_one_folder_for_several_is_refused(self, words, said):
        with pytest.raises(ConfigError, match=said):
            make_jobs(plan(words))

    def test_no_run_at_a_time_is_no_sweep(self):
        with pytest.raises(ConfigError, match="jobs_per_gpu"):
            plan(["jobs_per_gpu=0"])


@pytest.mark.parametrize("beside", [[], ["recipe=v1"]])
def test_an_unknown_key_names_the_nearest_of_the_sweep_and_of_its_trainings(beside):
    said = r"Unknown key 'dry_runs' of sweep\. Did you mean 'dry_run'\? Valid: .*jobs_per_gpu.*train\.\*"
    with pytest.raises(UnknownNameError, match=said + r".*roboverse sweep --help"):
        plan(["dry_runs=true", *beside])
    with pytest.raises(UnknownNameError, match=r"'simulatr' of sweep\. Did you mean 'simulator'"):
        plan(["simulatr=mujoco"])


def test_a_key_with_more_values_than_anyone_runs_is_refused():
    with pytest.raises(ConfigError, match=r"'seed=range\(1e9\)' has more than 1,000 values"):
        values_of_key("seed=range(1e9)")
    assert len(values_of_key("seed=range(1000)")) == 1000


class TestJobs:
    def test_shared_dataset_is_collected_once_and_first(self, tmp_path):
        same = ["cameras=[front]", "image_size=64", "num_demos=9", f"runs_dir={tmp_path}"]
        jobs, complete = make_jobs(plan([*WORDS, *same]))
        assert complete == []
        collections = [job for job in jobs if job.words[0] == "collect"]
        trainings = [job for job in jobs if job.words[0] == "train"]
        assert (len(collections), len(trainings)) == (4, 8)
        assert len({job.name for job in jobs}) == len(jobs)
        assert {job.after for job in trainings} == {job.name for job in collections}
        assert {job.after for job in collections} == {None}
        assert all(job.after in [each.name for each in jobs[:k]] for k, job in enumerate(jobs) if job.after)

    def test_policies_that_learn_from_an_env_collect_nothing(self, tmp_path):
        jobs, _ = make_jobs(plan(["policy=tdmpc2", f"runs_dir={tmp_path}"]))
        assert [(job.words[0], job.after) for job in jobs] == [("train", None)]

    @pytest.mark.slow
    @pytest.mark.parametrize(
        "words",
        [
            ["preset=quick", "num_demos=1000"],
            ["preset=gpu", "cameras=[front]"],
            ["task=PickCube", "task_kwargs.variant=lift", "only=camera", "materials=my-images"],
            ["simulator=mujoco_warp", "simulator_settings.njmax=768"],
            [
                "scenario.physics.decimation=50",
                "scenario.room=null",
                "scenario.cameras.front.pos=[1,0,0.5]",
                "scenario.cameras.wrist.turns=false",
            ],
            [
                "scenario.appearance.lights=[{kind:area},{}]",
                "scenario.appearance.materials.wall.texture=wood-017",
            ],
            ["scenario.appearance.lights.0.intensity=0.5"],
            ["scenario.objects.cube.mjcf='a,b.xml'", "materials=a=b"],
            ["scenario.objects.cube={mjcf:'it\\'s [a], {b}: c\\\\'}"],
            ["scenario.objects.cube.mjcf='3'", r"scenario.appearance.materials.wall.texture='${x}-1'"],
            ["simulator_settings.cone='elliptic'", "scenario.objects.cube.mjcf='null'"],
        ],
    )
    def test_the_collection_is_that_of_the_run(self, words):
        """Whatever a preset says and a word changes again."""
        planned = plan(words)
        ((_, config),) = planned.runs
        job = make_jobs(planned)[0][0]
        collection = compose("collect", job.words[1:])
        assert dataset_folder(collection) == dataset_folder(config)
        ours, theirs = to_values(collection), to_values(config)
        for key in set(flat_keys(to_values(CollectConfig()))) - {"preset"}:
            assert at(ours, key) == at(theirs, key), key

    @pytest.mark.slow
    @settings(max_examples=100, deadline=None)
    @given(text=st.text(st.characters(codec="utf-8", exclude_categories=["Cc"]), min_size=1))
    @example(text="null")
    @example(text="a,b")
    @example(text=r"\\${x} it's \\\\")
    def test_any_text_inside_a_value_reaches_the_collection_as_it_is(self, text):
        config = replace(compose("train", []), env=EnvSpec(scenario={"objects": {"cube": {"mjcf": text}}}))
        job = make_jobs(Sweep(SweepConfig(), (((), config),)))[0][0]
        assert compose("collect", job.words[1:]).env.scenario == config.env.scenario

    def test_run_is_complete_once_evaluated_as_configured(self, tmp_path):
        from roboverse_learn.commands.run_folder import RunFolder

        words = ["task=PickCube", f"runs_dir={tmp_path}"]
        ((_, config),) = plan(words).runs
        result = tmp_path / "result.json"
        with RunFolder.open(config, ["train"]) as run, run.stage("evaluate") as facts:
            facts["result"] = str(result)
        assert len(make_jobs(plan(words))[0]) == 2  # its result is gone
        result.write_text("{}")
        assert make_jobs(plan(words)) == ([], [run.folder])
        assert len(make_jobs(plan([*words, "evaluate.episodes=7"]))[0]) == 2

    def test_a_dry_run_prints_commands_that_can_be_typed(self, tmp_path, capsys):
        assert cli.main(["sweep", "seed=0,1", f"runs_dir={tmp_path}", "cameras=[front]", "dry_run=true"]) == 0
        lines = capsys.readouterr().out.splitlines()
        assert lines == [
            "roboverse collect task=PickCube 'cameras=[front]'",
            f"roboverse train seed=0 runs_dir={tmp_path} 'cameras=[front]'",
            f"roboverse train seed=1 runs_dir={tmp_path} 'cameras=[front]'",
        ]

    def test_commands_of_a_dry_run_name_the_plugins(self, tmp_path, capsys, monkeypatch):
        (tmp_path / "my_nothing.py").write_text("")
        monkeypatch.syspath_prepend(tmp_path)
        monkeypatch.setenv(PLUGINS_VARIABLE, "")
        assert (
            cli.main(["sweep", "seed=0", f"runs_dir={tmp_path}", "plugins=[my_nothing]", "dry_run=true"]) == 0
        )
        lines = capsys.readouterr().out.splitlines()
        assert len(lines) == 2 and all(line.endswith(" 'plugins=[my_nothing]'") for line in lines)

    def test_levels_without_a_recipe_are_answered_with_those_of_the_evaluation(self):
        with pytest.raises(ConfigError, match=r"add recipe=<name>.* evaluate\.levels=\[\.\.\.\]"):
            plan(["levels=[0]"])
        with pytest.raises(ConfigError, match=r"as in recipe=act_v1\.$"):
            plan(["seeds=[0]"])


@pytest.fixture
def fake_program(tmp_path, monkeypatch):
    """Real processes, of a fake program that fails for seed=1."""
    (tmp_path / "fake.py").write_text(
        "import sys\nprint('working')\nwords = sys.argv[1:]\n"
        "sys.exit('error: no luck') if 'seed=1' in words else print('fine')\n"
    )
    fake = tmp_path / "python"
    fake.write_text(f'#!/bin/sh\nshift 2\nexec "{sys.executable}" "{tmp_path}/fake.py" "$@"\n')
    fake.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(fake))


def test_failures_are_reported_with_their_last_output(fake_program, tmp_path):
    words = ["seed=0,1", f"runs_dir={tmp_path}/runs", f"results_dir={tmp_path}/results"]
    with pytest.raises(SweepError, match="1 of 3 processes failed") as caught:
        sweep(plan(words))
    message = str(caught.value)
    assert "error: no luck" in message
    logs = sorted(path.name for path in Path(tmp_path, "runs", "sweep-logs").glob("*.log"))
    assert len(logs) == 3
    assert all((tmp_path / "runs" / "sweep-logs" / name).read_text().startswith("working") for name in logs)


@pytest.mark.slow
@pytest.mark.parametrize(("seeds", "written"), [("1", False), ("0,1", True)])
def test_the_leaderboard_stays_as_it_is_where_every_run_failed(seeds, written, fake_program, tmp_path):
    page = tmp_path / "results" / "leaderboard.html"
    page.parent.mkdir()
    page.write_text("as it was")
    words = [f"seed={seeds}", f"runs_dir={tmp_path}/runs", f"results_dir={tmp_path}/results"]
    with pytest.raises(SweepError, match="processes failed"):
        sweep(plan(words))
    assert (page.read_text() != "as it was") is written


@pytest.fixture
def damaged_result(tmp_path):
    """A results file that was cut off."""
    path = tmp_path / "results" / "v2" / "PickCube" / "act" / "cut.json"
    path.parent.mkdir(parents=True)
    path.write_text('{"schema_version": 3')
    return path


def test_a_damaged_result_of_another_run_leaves_the_report(fake_program, damaged_result, tmp_path, capsys):
    words = ["seed=0", f"runs_dir={tmp_path}/runs", f"results_dir={tmp_path}/results"]
    assert cli.main(["sweep", *words]) == 2
    said = capsys.readouterr()
    assert said.out == "1 runs are complete, 0 of them were before.\n"
    assert "error: No leaderboard was written" in said.err and str(damaged_result) in said.err


def test_a_damaged_result_of_another_run_leaves_what_failed(fake_program, damaged_result, tmp_path):
    words = ["seed=0,1", f"runs_dir={tmp_path}/runs", f"results_dir={tmp_path}/results"]
    with pytest.raises(SweepError, match=r"1 of 3 processes failed(.|\n)*no luck(.|\n)*No leaderboard was"):
        sweep(plan(words))
