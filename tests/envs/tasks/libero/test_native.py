"""LIBERO's own interface: actions, observations and starts, as LeRobot's environment of it has them."""

import json
import math

import mujoco
import numpy as np
import pytest
import torch

from envs.core.errors import ConfigError, MissingExtraError, UnknownNameError
from envs.experts.actor import expert_episodes
from envs.mjcf.model import build_models
from envs.robots.franka import FRANKA_TORQUE
from envs.scenario import ScenarioCfg
from envs.spec import EnvSpec
from envs.tasks.libero.native import STATE_NAMES, axis_angle, hand_rotation
from envs.tasks.protocols import PROTOCOLS
from roboverse_learn import cli
from roboverse_learn.collect import collect_dataset
from roboverse_learn.config.compose import compose
from roboverse_learn.data import DatasetInfo, ResidentDataset
from roboverse_learn.data.dataset.recording import RecordingReader

TASK = "libero/object/pick_up_the_milk_and_place_it_in_the_basket"
KWARGS = dict(PROTOCOLS.get("libero").env["task_kwargs"])
PX = 16


@pytest.fixture(scope="module")
def env():
    spec = EnvSpec(task=TASK, task_kwargs=KWARGS, cameras=("image", "image2"), image_size=PX)
    try:
        env = spec.make(2, split="test", num_threads=1)
    except MissingExtraError as error:
        pytest.skip(str(error))
    yield env
    env.close()


@pytest.mark.parametrize(
    ("rot", "expected"),
    [
        ((1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        ((0.0, 1.0, 0.0, 0.0), (math.pi, 0.0, 0.0)),
        ((0.5**0.5, 0.0, 0.0, 0.5**0.5), (0.0, 0.0, math.pi / 2)),
        ((-(0.5**0.5), 0.0, 0.0, 0.5**0.5), (0.0, 0.0, 1.5 * math.pi)),  # LeRobot does not shorten it
    ],
)
def test_an_orientation_is_an_axis_times_an_angle(rot, expected):
    got = axis_angle(torch.tensor([rot], dtype=torch.float64))[0]
    np.testing.assert_allclose(got, expected, atol=1e-9)


def test_axes_times_angles_are_those_of_lerobots_processor():
    processor = pytest.importorskip("lerobot.processor.env_processor").LiberoProcessorStep()
    rots = torch.nn.functional.normalize(torch.randn(50, 4, generator=torch.Generator().manual_seed(0)))
    theirs = processor._quat2axisangle(rots[:, [1, 2, 3, 0]])
    torch.testing.assert_close(axis_angle(rots), theirs, atol=1e-5, rtol=1e-5)


def test_the_hands_orientation_is_mujocos_with_its_sign():
    model = build_models(ScenarioCfg(robots=(FRANKA_TORQUE,), table=None, room=None))[1]
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    low, high = np.array([joint.range for joint in FRANKA_TORQUE.joints]).T
    for joints in rng.uniform(low, high, (20, len(low))):
        for joint, value in zip(FRANKA_TORQUE.joints, joints, strict=True):
            data.joint(f"franka/{joint.name}").qpos = value
        mujoco.mj_kinematics(model, data)
        ours = hand_rotation(FRANKA_TORQUE, torch.from_numpy(joints[None]))[0]
        np.testing.assert_allclose(ours, data.body("franka/right_hand").xquat, rtol=0, atol=1e-6)


@pytest.mark.slow
def test_observations_and_actions_have_liberos_names_and_sizes(env):
    env.reset_envs([0, 1], env.split_indices[:2])
    seen = env.observe()
    assert set(seen) == {"observation.state", "observation.images.image", "observation.images.image2", "task"}
    assert seen["observation.state"].shape == (2, 8) and env.state_names == STATE_NAMES
    assert env.single_action_space.shape == (7,) and (env.single_action_space.high == 1.0).all()
    assert (env.control_hz, env.max_episode_steps) == (20.0, 600)
    assert env.single_observation_space["agent_pos"].contains(seen["observation.state"][0])
    state = seen["observation.state"]
    robot = env.get_states().robots["franka"]
    np.testing.assert_allclose(state[:, :3], robot.ee_pos, atol=1e-6)
    np.testing.assert_allclose(np.abs(state[:, 3:6]), [[math.pi, 0.0, 0.0]] * 2, atol=0.2)  # points down
    np.testing.assert_allclose(state[:, 6:], [[0.0387, -0.0387]] * 2, atol=1e-4)  # open, short of its target


@pytest.mark.slow
def test_images_are_mirrored_as_lerobot_turns_them(env):
    """LIBERO's images are upside down; LeRobot turns them by 180°, which leaves left and right exchanged."""
    env.reset_envs([0, 1], env.split_indices[:2])
    seen = env.observe()["observation.images.image"]
    upright = np.stack([env.image(0), env.image(1)])
    raw = upright[:, ::-1]
    assert (seen == raw[:, ::-1, ::-1]).all() and not (seen == upright).all()
    observation, _ = env.reset(options={"episodes": env.split_indices[:2].tolist()})
    assert (observation["pixels"]["image"] == seen).all()


@pytest.mark.slow
def test_the_kth_episode_begins_in_the_kth_of_liberos_states(env):
    milk = {}
    for first in (0, 3, 48, 50):
        env.reset_envs([0, 1], env.split_indices[first : first + 2])
        milk[first] = env.get_states().objects["milk_1"].pos.clone()
    for first in (0, 3, 48):
        for row in range(2):
            assert torch.equal(milk[first][row], env.task.fixed_start(first + row).objects["milk_1"].pos[0])
    assert torch.equal(milk[50], milk[0]), "after the fiftieth they begin again"
    env.reset(seed=[3, 53])
    np.testing.assert_array_equal(env.episodes, env.split_indices[[3, 3]])


@pytest.mark.slow
def test_its_expert_solves_it_by_liberos_actions(env):
    (episode,) = expert_episodes(env, env.split_indices[:1].tolist(), record=("states",))
    assert episode.success and 50 < episode.length < 300
    actions = np.stack(episode.actions)
    assert actions.shape[1] == 7 and np.abs(actions).max() <= 1.0
    assert {-1.0, 1.0} <= set(actions[:, 6]), "the hand was opened and closed"


@pytest.mark.parametrize(
    ("options", "error", "said"),
    [
        ({"action_space": "natve"}, UnknownNameError, "Unknown action_space of .* Did you mean 'native'"),
        ({"starts": "fixed"}, UnknownNameError, "Valid: libero, regions"),
        ({"horizon": 0}, ConfigError, "must be a number of control steps, or lerobot, given 0"),
        ({"horizon": "lerobt"}, ConfigError, "or lerobot, given 'lerobt'"),
    ],
)
def test_options_are_checked(options, error, said):
    with pytest.raises(error, match=said):
        EnvSpec(task=TASK, task_kwargs=options).make_task()


@pytest.mark.parametrize(
    ("task", "steps"),
    [
        ("libero/object/pick_up_the_milk_and_place_it_in_the_basket", 280),
        ("libero/goal/turn_on_the_stove", 300),
        ("libero/10/kitchen_scene3_turn_on_the_stove_and_put_the_moka_pot_on_it", 520),
        ("libero/90/kitchen_scene4_put_the_wine_bottle_on_the_wine_rack", 400),
    ],
)
def test_lerobots_limits_of_steps_are_by_suite(task, steps):
    assert EnvSpec(task=task, task_kwargs={"horizon": "lerobot"}).make_task().max_episode_steps == steps
    assert EnvSpec(task=task, task_kwargs={"horizon": 7}).make_task().max_episode_steps == 7
    assert EnvSpec(task=task).make_task().max_episode_steps == 600


@pytest.mark.parametrize(
    ("source", "needed"), [("augment", "from"), ("retarget", "from"), ("robosuite", "path")]
)
def test_collection_refuses_an_observation_that_its_source_does_not_record(env, source, needed):
    words = [f"task={TASK}", "task_kwargs.observation_space=native"]
    config = compose("collect", [*words, f"source={source}", f"{needed}=somewhere"])
    with pytest.raises(
        ConfigError, match=rf"source={source} .* collect with source=expert or policy or rerender"
    ):
        collect_dataset(config)


@pytest.mark.slow
def test_demonstrations_have_liberos_names_and_what_a_policy_would_have_seen(env, tmp_path):
    words = [
        f"task={TASK}",
        "num_demos=1",
        f"image_size={PX}",
        f"datasets_dir={tmp_path}",
        "level=0",
        "cameras=[all]",
    ]
    kwargs = [f"task_kwargs.{key}=native" for key in ("action_space", "observation_space")]
    folder = collect_dataset(compose("collect", [*words, *kwargs, "collect.num_workers=1"])).root
    info = DatasetInfo.open(folder)
    assert info.features["observation.state"]["names"] == list(STATE_NAMES)
    assert info.features["action"]["shape"] == [7] and info.fps == 20
    assert set(info.camera_keys) == {"observation.images.image", "observation.images.image2"}
    recording = RecordingReader(folder).read(0)
    columns = info.read_columns(["observation.state"])["observation.state"]
    assert len(columns) == recording.num_steps
    env.reset_envs([0], env.split_indices[:1], recording.states.select([20]))
    seen = env.observe([0])
    np.testing.assert_allclose(columns[20], seen["observation.state"][0], atol=1e-5)
    images = ResidentDataset(folder).sample([20], {key: [0] for key in info.camera_keys})
    for key in info.camera_keys:
        stored = images[key][0, 0].permute(1, 2, 0).numpy().astype(float)
        live = seen[key][0].astype(float)
        assert np.abs(stored - live).mean() < 0.3 * np.abs(stored - live[:, ::-1]).mean()


def test_a_protocol_sets_what_is_not_typed_beside_it():
    config = compose("evaluate", ["policy=zero", "suite=libero_10", "protocol=libero", "episodes=3"])
    assert config.env["task_kwargs"] == KWARGS and config.env["cameras"] == ("image", "image2")
    assert (config.evaluate.levels, config.evaluate.splits) == ((0,), ("test",))
    assert config.evaluate.episodes == 3
    longer = compose(
        "evaluate", ["policy=zero", f"task={TASK}", "protocol=libero_lerobot", "task_kwargs.horizon=9"]
    )
    assert longer.env["task_kwargs"] == {**KWARGS, "horizon": 9} and longer.evaluate.episodes == 50
    with pytest.raises(UnknownNameError, match=r"Unknown protocol 'libro'\. Did you mean 'libero'"):
        compose("evaluate", ["policy=zero", "suite=libero_10", "protocol=libro"])


@pytest.mark.slow
def test_a_policy_of_lerobot_with_liberos_features_runs_by_the_protocol(env, tmp_path):
    """The inputs and outputs of the public datasets: two images, a state of 8, an action of 7."""
    from lerobot.configs import FeatureType, PolicyFeature
    from lerobot.policies.act.configuration_act import ACTConfig
    from lerobot.policies.act.modeling_act import ACTPolicy
    from lerobot.policies.factory import make_pre_post_processors

    image = PolicyFeature(type=FeatureType.VISUAL, shape=(3, 32, 32))
    config = ACTConfig(
        input_features={
            "observation.images.image": image,
            "observation.images.image2": image,
            "observation.state": PolicyFeature(type=FeatureType.STATE, shape=(8,)),
        },
        output_features={"action": PolicyFeature(type=FeatureType.ACTION, shape=(7,))},
        device="cpu", pretrained_backbone_weights=None, push_to_hub=False, chunk_size=4, n_action_steps=4,
        dim_model=32, n_heads=2, dim_feedforward=32, n_encoder_layers=1, n_decoder_layers=1, use_vae=False,
    )  # fmt: skip
    folder = tmp_path / "theirs" / "pretrained_model"
    ACTPolicy(config).save_pretrained(folder)
    one = {"mean": torch.zeros(1), "std": torch.ones(1), "min": torch.zeros(1), "max": torch.ones(1)}
    sizes = {"observation.state": 8, "action": 7}
    stats = {
        key: {name: value.expand(size).clone() for name, value in one.items()} for key, size in sizes.items()
    }
    stats |= {key: {name: value.expand(3).reshape(3, 1, 1).clone() for name, value in one.items()}
              for key in config.input_features if "images" in key}  # fmt: skip
    for processor in make_pre_post_processors(config, dataset_stats=stats):
        processor.save_pretrained(folder)
    words = [f"task={TASK}", "protocol=libero", "episodes=1", "task_kwargs.horizon=6", "videos=0"]
    assert cli.main(["evaluate", f"checkpoint={folder}", *words, f"results_dir={tmp_path}/results"]) == 0
    (path,) = (tmp_path / "results").glob(f"v2/{TASK}/act/*.json")
    result = json.loads(path.read_text())
    assert result["env"]["cameras"] == ["image", "image2"] and result["env"]["image_size"] == 32
    assert [cell["length"] for cell in result["records"]] == [[6]]


def test_lerobots_command_takes_a_suite_and_a_protocol():
    lerobot = pytest.importorskip("envs.lerobot")
    config = lerobot.RoboVerseEnvConfig(task="paper")
    made = config.create_envs(2)["paper"]
    assert list(made) == list(range(6)) and made[0].num_envs == 2
    assert [each._env for each in made.values()] == [None] * 6, "each is made when it is evaluated"
    assert made[1].call("task") == ("StackCube", "StackCube")
    made[1].close()
    assert made[1]._env is None


@pytest.mark.slow
def test_lerobots_environment_has_liberos_features(env):
    from envs.lerobot import RoboVerseEnvConfig

    config = RoboVerseEnvConfig(task="libero_object", protocol="libero", image_size=PX)
    assert config.tasks[9] == TASK or TASK in config.tasks
    shapes = {config.features_map[key]: feature.shape for key, feature in config.features.items()}
    assert shapes == {
        "action": (7,),
        "observation.state": (8,),
        "observation.images.image": (PX, PX, 3),
        "observation.images.image2": (PX, PX, 3),
    }
    assert config.fps == 20
