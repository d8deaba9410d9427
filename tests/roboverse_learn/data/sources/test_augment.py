import json
import shutil

import numpy as np
import pytest

from envs.core.errors import ConfigError, DatasetError, UnknownNameError
from envs.spec import EnvSpec
from envs.tasks.pick_cube import PickCube
from envs.tasks.segment import Segment
from roboverse_learn.collect import collect_dataset, dataset_folder
from roboverse_learn.config.compose import compose
from roboverse_learn.data import DatasetInfo, read_raw
from roboverse_learn.data.augmentation import check
from roboverse_learn.data.augmentation.config import AugmentConfig
from roboverse_learn.data.augmentation.sources import read_sources
from roboverse_learn.data.sources import SOURCES
from roboverse_learn.data.sources.augment import AUGMENT_PATH
from tests.roboverse_learn.data.augmentation.expert_demos import write_demos
from tests.roboverse_learn.data.importers.test_real_files import real


@pytest.fixture(scope="session")
def demos(tmp_path_factory):
    """A dataset of four demonstrations of PickCube without images; tests only read it."""
    return write_demos(tmp_path_factory.mktemp("sources") / "PickCube", "PickCube", 4)


def config(demos, *words):
    return compose("collect", ["source=augment", f"from={demos}", "task=PickCube", *words])


@pytest.mark.slow
def test_dataset_is_generated_and_says_what_from(demos, tmp_path):
    words = ["num_demos=2", "image_size=32", "cameras=[front]", f"dataset={tmp_path / 'made'}"]
    made = config(demos, *words, "level=3", "collect.num_workers=1", "collect.num_envs=2")
    summary = collect_dataset(made)
    assert summary.outcome == "2 of 2 attempts were kept (100.0 %)"
    info = DatasetInfo.open(summary.root)
    own = {metadata["episode"] for metadata in DatasetInfo.open(demos).episode_metadata}
    for metadata in info.episode_metadata:
        assert metadata["source"] == "augment" and metadata["level"] == 3 and metadata["attempts"] == 1
        assert metadata["episode"] not in own and metadata["split"] == "train"
        assert [(p["reference"], p["carried"]) for p in metadata["pieces"]] == [
            ("cube", ""),
            ("cube", ""),
            ("goal", "cube"),
        ]
        assert {piece["demonstration"] for piece in metadata["pieces"]} <= {0, 1, 2, 3}
    content = json.loads((info.root / AUGMENT_PATH).read_text())
    assert content["sequence"] == "cube carried to goal" and content["demonstrations"] == [0, 1, 2, 3]
    assert content["augment"]["choose"] == "nearest" and content["left_out"] == {}
    assert collect_dataset(made).dataset_hash == summary.dataset_hash  # complete: nothing is made again
    arrays, _ = read_raw(info.root, 0)
    assert np.isfinite(arrays["robots/franka/ee_pos"]).all()
    with pytest.raises(DatasetError, match=r"was begun with.*Use the same settings"):
        collect_dataset(config(demos, *words, "level=3", "augment.noise_m=0", "collect.num_workers=1"))


@pytest.mark.slow
def test_task_is_that_of_the_dataset(demos, tmp_path):
    words = ["source=augment", f"from={demos}"]
    assert compose("collect", words).env.task == "PickCube"
    other = write_demos(tmp_path / "CloseBox", "CloseBox", 1)
    assert compose("collect", ["source=augment", f"from={other}"]).env.task == "CloseBox"
    with pytest.raises(ConfigError, match="holds demonstrations of CloseBox, and task=PickCube was given"):
        read_sources(other, PickCube(), AugmentConfig())
    stack = EnvSpec(task="StackCube").make_task()
    with pytest.raises(ConfigError, match=r"and task=StackCube was given: give task=CloseBox\.$"):
        read_sources(other, stack, AugmentConfig())


@pytest.mark.slow
def test_source_datasets_that_will_not_do_say_why(demos, tmp_path):
    with pytest.raises(ConfigError, match=r"augment.num_sources=9 was given, and from=.* holds 4 demonstr"):
        read_sources(demos, PickCube(), AugmentConfig(num_sources=9))
    bare = tmp_path / "bare"
    shutil.copytree(demos, bare)
    shutil.rmtree(bare / "raw")
    with pytest.raises(DatasetError, match="has no raw states of episode 0"):
        read_sources(bare, PickCube(), AugmentConfig())
    with pytest.raises(DatasetError, match="There is no dataset in"):
        read_sources(tmp_path / "nothing", PickCube(), AugmentConfig())
    tested = write_demos(tmp_path / "tested", "PickCube", 1, split="test")
    with pytest.raises(ConfigError, match="is of the test split, which is for evaluation alone"):
        read_sources(tested, PickCube(), AugmentConfig())
    with pytest.raises(DatasetError, match=r"Lower augment\.least_steps"):
        read_sources(demos, PickCube(), AugmentConfig(least_steps=500))
    with pytest.raises(ConfigError, match="has no extra, which PickCube has with these options"):
        read_sources(demos, _PickTwo(), AugmentConfig())
    with pytest.raises(
        ConfigError, match=r"of robot 'franka', and PickCube has 'ur5e' with .* Add robot=franka, or"
    ):
        read_sources(demos, config(demos, "robot=ur5e").env.make_task(), AugmentConfig())


class _PickTwo(PickCube):
    """A scene with a further object."""

    @property
    def scenario(self):
        from dataclasses import replace

        scene = super().scenario
        extra = replace(scene.objects[0], name="extra")
        return replace(scene, objects=(*scene.objects, extra))


@pytest.mark.slow
def test_task_without_an_arm_is_refused(demos):
    ant = EnvSpec(task="control/ant").make_task()
    from roboverse_learn.data.augmentation.recording import HandReader

    with pytest.raises(ConfigError, match="moves the hand of an arm by joint targets"):
        HandReader.of(ant)


@pytest.mark.slow
def test_stated_segments_overrule_what_is_found(demos):
    class Stated(PickCube):
        segments = (
            Segment(reference="cube", until=lambda state: state.objects["cube"].pos[:, 2] > 0.03),
            Segment(reference="goal", carries="cube"),
        )

    found = read_sources(demos, Stated(), AugmentConfig())
    assert found.sequence == "at cube, then at goal"
    usual = read_sources(demos, PickCube(), AugmentConfig())
    assert [piece.role for piece in found.sources[0].pieces] == [
        piece.role for piece in usual.sources[0].pieces
    ]
    assert found.sources[0].pieces[2].steps[0] > usual.sources[0].pieces[2].steps[0]


@pytest.mark.slow
def test_different_demonstration_is_left_out_and_named(demos, tmp_path):
    mixed = tmp_path / "mixed"
    shutil.copytree(demos, mixed)
    from safetensors.numpy import load_file, save_file

    path = mixed / "raw" / "episode_000001.safetensors"
    arrays = load_file(path)
    arrays["objects/cube/pos"][:] = arrays["objects/cube/pos"][0]  # this cube never moves
    from safetensors import safe_open

    with safe_open(path, "np") as file:
        header = file.metadata()
    save_file(arrays, path, header)
    found = read_sources(mixed, PickCube(), AugmentConfig())
    assert [source.demo.index for source in found.sources] == [0, 2, 3]
    assert str(found) == (
        "3 of 4 source demonstrations do the same: cube carried to goal. Left out: demonstration 1: nothing."
    )


def test_keys_are_checked():
    with pytest.raises(ConfigError, match="source=augment needs from=<folder>: a dataset of demonstrations"):
        compose("collect", ["source=augment"])
    with pytest.raises(ConfigError, match="from=x was given, and source=expert makes nothing from a dataset"):
        compose("collect", ["from=x"])
    with pytest.raises(ConfigError, match=r"Keys augment\.\* were given, and source=expert takes none"):
        compose("collect", ["augment.choose=random"])
    with pytest.raises(UnknownNameError, match=r"Did you mean 'augment\.choose'"):
        compose("collect", ["augment.chose=random"])
    with pytest.raises(ConfigError, match="input should be 'nearest' or 'random'"):
        compose("collect", ["augment.choose=neerest"])
    with pytest.raises(ConfigError, match=r"augment\.noise_m must be 0 to 0\.05, given 0\.2"):
        compose("collect", ["augment.noise_m=0.2"])
    with pytest.raises(ConfigError, match=r"augment\.bridge_speed_m_s must be above 0 and at most 2"):
        compose("collect", ["augment.bridge_speed_m_s=0"])
    with pytest.raises(ConfigError, match=r"augment\.nearest must be at least 1, given 0"):
        compose("collect", ["augment.nearest=0"])


@pytest.mark.slow
def test_name_of_a_dataset_says_what_it_is_made_from(demos):
    name = dataset_folder(config(demos, "num_demos=5", "augment.choose=random")).name
    assert "-5demos-augment-" in name and name.endswith("-choose=random")
    source = SOURCES.get("augment")(config(demos))
    assert source.identity()["augment"] == {
        name: getattr(AugmentConfig(), name) for name in AugmentConfig.__dataclass_fields__
    }
    own = {metadata["episode"] for metadata in DatasetInfo.open(demos).episode_metadata}
    assert not own & set(source.candidates())


@pytest.mark.slow
def test_check_counts_attempts_without_images(demos, caplog):
    caplog.set_level("INFO")
    assert check.main([f"from={demos}", "task=PickCube", "episodes=2", "expert=true"]) == 0
    lines = [record.getMessage() for record in caplog.records if "PickCube," in record.getMessage()]
    assert [line.partition(" kept")[0] for line in lines] == [
        "PickCube, augment: 2 of 2",
        "PickCube, expert: 2 of 2",
    ]
    assert check.main([f"from={demos}", "task=PickCube", "episodes=none"]) == 2
    assert check.main([f"from={demos}", "task=PickCube", "expert=yes"]) == 2
    assert "episodes must be a number above 0, given none" in caplog.text


@pytest.mark.slow
def test_what_another_arm_followed_is_augmented(demos, tmp_path, caplog):
    followed = tmp_path / "ur5e"
    words = ["source=retarget", f"from={demos}", "task=PickCube", "robot=ur5e", "num_demos=4"]
    words += ["cameras=[front]", "image_size=32", "num_workers=1", f"dataset={followed}"]
    assert collect_dataset(compose("collect", words)).num_episodes == 4
    caplog.set_level("INFO")
    assert check.main([f"from={followed}", "task=PickCube", "robot=ur5e", "episodes=3"]) == 0
    assert "PickCube, augment: 3 of 3 kept" in caplog.text


@pytest.mark.long
def test_one_recording_of_a_person_is_augmented(tmp_path, caplog):
    recorded = real("robosuite_demos/panda_nut-assembly_demo.hdf5")
    words = ["source=robosuite", f"path={recorded}", "task=NutAssemblySquare", "cameras=[front]"]
    collect_dataset(compose("collect", [*words, "image_size=32", f"dataset={tmp_path / 'person'}"]))
    caplog.set_level("INFO")
    assert check.main([f"from={tmp_path / 'person'}", "task=NutAssemblySquare", "episodes=8"]) == 0
    (line,) = [record.getMessage() for record in caplog.records if "augment: " in record.getMessage()]
    assert int(line.partition("augment: ")[2].split()[0]) >= 6, line
