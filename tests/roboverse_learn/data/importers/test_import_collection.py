import json
import shutil
from io import StringIO

import h5py
import numpy as np
import pytest
import safetensors.numpy

from envs.core.errors import ConfigError, DatasetError, UnknownNameError
from envs.randomization import load_split
from roboverse_learn.collect import collect_dataset, dataset_folder
from roboverse_learn.commands.report import collection_report
from roboverse_learn.config.compose import compose
from roboverse_learn.data import CollectionConfig, DatasetInfo, collect
from roboverse_learn.data.importers.maniskill import ManiSkillFile
from roboverse_learn.data.importers.robosuite import RobosuiteFile
from roboverse_learn.data.importers.verdicts import (
    IMPORT_PATH,
    ImportSummary,
    Verdict,
    find_files,
    judge,
)
from roboverse_learn.data.sources import SOURCES
from tests.roboverse_learn.data.importers.recordings import (
    roboverse_episode,
    write_maniskill,
    write_robosuite,
)
from tests.roboverse_learn.data.synthetic_episodes import FEATURES, FPS

TRAIN = load_split("train").episodes.tolist()


def given(path, task=None, source="maniskill", replay="states"):
    file_type = SOURCES.get(source).file_type
    return {
        "file_type": file_type,
        "path": path,
        "replay": replay,
        "conditions": {"task": task or "PickCube"},
    }


@pytest.fixture
def folder(tmp_path, played):
    """Three files: two demonstrations of which one is damaged, a truncated file, and one demonstration."""
    folder = tmp_path / "files"
    folder.mkdir()
    with h5py.File(write_maniskill(folder / "a", played), "r+") as content:
        content["traj_0/env_states/actors/cube"][3] = np.nan
    whole = write_maniskill(folder / "b", played)
    whole.write_bytes(whole.read_bytes()[:-3000])
    write_maniskill(folder / "c", played[:1])
    return folder


def test_command_line_accepts_every_format():
    with pytest.raises(UnknownNameError, match=r"demonstrations 'manskill'\. Did you mean 'mani"):
        compose("collect", ["source=manskill", "path=x"])
    with pytest.raises(ConfigError, match=r"source=maniskill needs path=<file or folder>"):
        compose("collect", ["source=maniskill"])
    with pytest.raises(ConfigError, match=r"source=expert reads no file\. Name its format"):
        compose("collect", ["path=here"])


@pytest.mark.slow
def test_damage_loses_nothing_else(folder, pick_env):
    done = []
    summary = judge(**given(folder), env=pick_env, on_progress=lambda *now: done.append(now))
    assert [(v.file, v.name, v.states, v.controls) for v in summary.read] == [
        ("a.h5", "traj_1", True, True),
        ("c.h5", "traj_0", True, True),
    ]
    damaged, truncated = summary.skipped
    assert (damaged.file, damaged.name) == ("a.h5", "traj_0") and "not finite at 3" in damaged.error
    assert (truncated.file, truncated.name) == ("b.h5", "") and "not a complete HDF5 file" in truncated.error
    assert sorted(summary.files) == ["a.h5", "b.h5", "c.h5"]
    assert (summary.num_said, summary.num_agreeing, summary.num_with_states) == (2, 2, 2)
    # Every demonstration has looks of its own, whatever became of the ones before it.
    assert [v.episode for v in summary.verdicts] == [TRAIN[0], TRAIN[1], -1, TRAIN[2]]
    assert done[-1] == (4, 4)


def test_a_demonstration_that_breaks_the_simulation_is_named(tmp_path, played, pick_env):
    with h5py.File(write_maniskill(tmp_path / "a", played), "r+") as content:
        content["traj_0/env_states/actors/cube"][0, 7] = 1e200
    summary = judge(**given(tmp_path / "a.h5"), env=pick_env)
    assert [v.name for v in summary.read] == ["traj_1"]
    assert "no longer finite" in summary.skipped[0].error or "MuJoCo stopped" in summary.skipped[0].error


def still_clock(folder, played):
    with h5py.File(write_robosuite(folder / "a.hdf5", played), "r+") as content:
        content["data/demo_1/states"][:, 0] = 0.5


def robots_that_are_a_number(folder, played):
    with h5py.File(write_robosuite(folder / "a.hdf5", played), "r+") as content:
        content["data"].attrs["env_info"] = json.dumps({"robots": 1})


def model_that_is_no_xml(folder, played):
    with h5py.File(write_robosuite(folder / "a.hdf5", played), "r+") as content:
        content["data/demo_1"].attrs["model_file"] = "<mujoco><worldbody></mujoco>"


def start_that_is_null(folder, played):
    (folder / "a.json").write_text(json.dumps({"franka": [{"init_state": None, "actions": []}]}))


def frequency_that_is_a_word(folder, played):
    write_maniskill(folder / "a", played, sim_config={"control_freq": "fast"})


def whole(source, folder, played):
    """Writes a file of one demonstration; returns its path."""
    if source == "maniskill":
        return write_maniskill(folder / "b", played)
    if source == "robosuite":
        return write_robosuite(folder / "b.hdf5", played)
    (folder / "b.json").write_text(json.dumps({"franka": [roboverse_episode(one) for one in played]}))
    return folder / "b.json"


@pytest.mark.parametrize(
    ("source", "damaged", "name", "says"),
    [
        ("robosuite", still_clock, "demo_1", "ZeroDivisionError: "),
        ("robosuite", robots_that_are_a_number, "", "TypeError: 'int' object is not iterable"),
        ("robosuite", model_that_is_no_xml, "demo_1", "ParseError: mismatched tag"),
        ("roboverse", start_that_is_null, "franka_0", "TypeError: 'NoneType' object is not"),
        ("maniskill", frequency_that_is_a_word, "", "ValueError: could not convert string to float: 'fast'"),
    ],
)
def test_a_file_of_wrong_values_is_refused_by_name_and_the_others_are_imported(
    tmp_path, request, source, damaged, name, says
):
    env, played = ("pick_env", "played") if source == "maniskill" else ("lift_env", "lifted")
    env, played = request.getfixturevalue(env), request.getfixturevalue(played)[:1]
    damaged(tmp_path, played)
    other = whole(source, tmp_path, played)
    summary = judge(**given(tmp_path, source=source), env=env)
    assert [(v.file, v.states) for v in summary.read] == [(other.name, True)]
    (skipped,) = summary.skipped
    file = other.with_stem("a")
    assert (skipped.file, skipped.name) == (file.name, name)
    what = f"'{name}' of '{file}'" if name else f"'{file}'"
    assert skipped.error.startswith(f"{what} is incomplete or damaged ({says}")
    assert skipped.error.endswith(" Download or record it again.")


def test_what_is_no_demonstration_is_refused(tmp_path, folder, pick_env, lift_env, lifted):
    with pytest.raises(DatasetError, match=r"does not exist\. Give a file of maniskill, or a folder of them"):
        find_files(ManiSkillFile, tmp_path / "nowhere")
    with pytest.raises(DatasetError, match=r"holds no file of robosuite \(\.hdf5\)"):
        find_files(RobosuiteFile, folder)
    with pytest.raises(DatasetError, match="not a complete HDF5 file"):
        judge(**given(folder / "b.h5"), env=pick_env)
    file = write_robosuite(tmp_path / "lift.hdf5", lifted, env="Juggle")
    with pytest.raises(DatasetError, match="no registered task is the same"):
        judge(**given(file, source="robosuite"), env=lift_env)


def test_demonstrations_of_every_format_pass(tmp_path, lifted, lift_env):
    (tmp_path / "lift.json").write_text(json.dumps({"franka": [roboverse_episode(one) for one in lifted]}))
    write_robosuite(tmp_path / "lift.hdf5", lifted)
    for source, name in (("roboverse", "lift.json"), ("robosuite", "lift.hdf5")):
        summary = judge(**given(tmp_path / name, source=source), env=lift_env)
        assert (summary.count("states"), summary.count("controls")) == (2, 2), source


def test_a_file_without_states_is_replayed_by_controls(tmp_path, lifted, lift_env):
    episodes = [roboverse_episode(one, states=False) for one in lifted]
    (tmp_path / "lift.json").write_text(json.dumps({"franka": episodes}))
    summary = judge(**given(tmp_path / "lift.json", source="roboverse"), env=lift_env)
    assert (summary.num_with_states, summary.count("states"), summary.count("controls")) == (0, 0, 2)
    with pytest.raises(ConfigError, match=r"no recorded states\. Give replay=controls"):
        summary.chosen()


def test_none_that_passes_is_an_error_that_says_how_many_do():
    verdicts = (
        Verdict(file="a", name="1", states=False, controls=True),
        Verdict(file="a", name="2", error="X."),
    )
    summary = ImportSummary(source="maniskill", replay="states", files={}, conditions={}, verdicts=verdicts)
    with pytest.raises(
        DatasetError, match=r"1 demonstrations passes by states \(by states 0, by controls 1\).*X"
    ):
        summary.chosen()


def words(file, root, *more):
    fixed = ["task=PickCube", "source=maniskill", f"path={file}", f"dataset={root}", "image_size=32"]
    return compose("collect", [*fixed, "collect.num_workers=1", "num_envs=2", "level=1", *more])


@pytest.mark.slow
def test_a_dataset_like_the_experts(folder, tmp_path, open_with_lerobot, pick_env):
    root = tmp_path / "dataset"
    summary = collect_dataset(words(folder, root))
    said = _printed(collection_report(summary))
    assert "Read 2 demonstrations of maniskill: 2 of 2 pass by states, 2 of 2 pass by controls." in said
    assert "Imported 2 by states." in said and "agrees with 2 of the 2 outcomes" in said
    assert "a.h5 traj_0: The state of 'cube' is not finite at 3" in said and "b.h5: " in said

    info = DatasetInfo.open(root)
    metadata = info.episode_metadata
    assert [m["episode"] for m in metadata] == [TRAIN[1], TRAIN[2]]
    assert [(m["file"], m["demonstration"]) for m in metadata] == [("a.h5", "traj_1"), ("c.h5", "traj_0")]
    for one in metadata:
        assert (one["source"], one["replay"], one["split"], one["level"]) == (
            "maniskill",
            "states",
            "train",
            1,
        )
        assert one["file_success"] is True and len(one["file_sha256"]) == 64
    assert len(open_with_lerobot(root)) == info.num_frames
    # What was recorded is what the file says.
    opened = ManiSkillFile(folder / "a.h5", pick_env.task)
    recorded = opened.read("traj_1").states.objects["cube"].pos
    opened.close()
    raw = safetensors.numpy.load_file(info.raw_file(0))["objects/cube/pos"]
    np.testing.assert_allclose(raw, recorded[: len(raw)], atol=1e-9)

    saved = json.loads((root / IMPORT_PATH).read_text())
    assert saved["num_read"] == 2 and saved["num_passing"] == {"states": 2, "controls": 2}
    assert [episode["name"] for episode in saved["episodes"]] == ["traj_0", "traj_1", "", "traj_0"]


@pytest.mark.slow
def test_repeated_import_does_nothing_and_another_file_is_refused(tmp_path, played, monkeypatch):
    file, root = write_maniskill(tmp_path / "a", played), tmp_path / "dataset"
    first = collect_dataset(words(file, root, "num_demos=1", "replay=controls"))
    assert first.num_episodes == 1 and first.imported.count("controls") == 2
    with monkeypatch.context() as patch:
        patch.setattr("roboverse_learn.data.importers.verdicts.judge", None)
        again = collect_dataset(words(file, root, "num_demos=1", "replay=controls"))
    assert again.dataset_hash == first.dataset_hash
    grown = collect_dataset(words(file, root, "replay=controls"))
    assert grown.num_episodes == 2
    with h5py.File(file, "r+") as content:
        content["traj_0/actions"][0, 0] += 1e-3
    with pytest.raises(DatasetError, match="was begun with files="):
        collect_dataset(words(file, root, "replay=controls"))
    shutil.rmtree(root)
    with pytest.raises(DatasetError, match=r"which is not StackCube .*Give task=PickCube\."):
        collect_dataset(words(file, root, "task=StackCube"))


def test_folders_of_datasets_do_not_collide():
    plain = dataset_folder(compose("collect", []))
    named = [
        dataset_folder(compose("collect", ["source=roboverse", f"path=x/{name}", f"replay={by}"]))
        for name in ("franka.pkl.gz", "sawyer.pkl.gz")
        for by in ("states", "controls")
    ]
    assert len({plain, *named}) == 5
    assert named[0].name.endswith("-roboverse-franka-by-states")


@pytest.mark.slow
@pytest.mark.parametrize("num_workers", [1, 2])
def test_fewer_successes_can_be_enough(tmp_path, monkeypatch, num_workers):
    monkeypatch.syspath_prepend(str(__import__("pathlib").Path(__file__).parents[1]))
    settings = {
        "root": tmp_path / "d",
        "num_episodes": 9,
        "candidates": list(range(100, 105)),
        "source": "synthetic_episodes:SyntheticSource",
        "source_kwargs": {},
        "fps": FPS,
        "features": FEATURES,
        "num_workers": num_workers,
    }
    summary = collect(CollectionConfig(**settings, fewer_ok=True))
    assert (summary.num_episodes, summary.num_attempts) == (3, 5)  # 100 and 104 fail
    again = collect(CollectionConfig(**settings, fewer_ok=True))
    assert again.dataset_hash == summary.dataset_hash
    none = settings | {"root": tmp_path / "none", "candidates": [100, 104]}
    with pytest.raises(DatasetError, match="The 2 candidate episodes gave 0 successes"):
        collect(CollectionConfig(**none, fewer_ok=True))


def _printed(report):
    from rich.console import Console

    console = Console(width=300, file=StringIO())
    console.print(report)
    return console.file.getvalue()
