"""``policy=lerobot`` without transformers: types, keys, cameras, checkpoints, a type without extras."""

import json
import re

import pytest

import policies
from envs.core.errors import ConfigError, MissingExtraError, PolicyError, UnknownNameError
from envs.core.extras import install_command
from policies import checkpoint
from policies.checkpoint import REGISTERED_AS
from policies.zoo import preflight
from policies.zoo.config import LeRobotConfig, PeftConfig, full_rename_map
from policies.zoo.types import settings_of, type_names
from roboverse_learn.config.compose import compose
from roboverse_learn.config.serialize import from_values, to_values
from tests.policies.examples import FEATURES, stats
from tests.policies.zoo.foreign import check, evaluate, image, smolvla_base, write

LANGUAGE = {"smolvla", "pi0", "pi05", "pi0_fast", "xvla", "multi_task_dit", "groot", "wall_x", "eo1"}


def train(*words: str) -> LeRobotConfig:
    return compose("train", ["policy=lerobot", *words]).policy


class TestTypes:
    def test_are_those_of_lerobots_registry(self):
        from lerobot.configs import PreTrainedConfig
        from lerobot.policies import factory  # noqa: F401, which registers them

        ours = set(REGISTERED_AS)
        known = set(PreTrainedConfig.get_known_choices()) - {"gaussian_actor", "tdmpc"} - ours
        assert set(type_names()) == known
        assert known > LANGUAGE | {"act", "diffusion", "vqbet"}

    @pytest.mark.parametrize("name", type_names())
    def test_settings_are_the_fields_of_lerobots_configuration(self, name):
        from dataclasses import fields

        from lerobot.configs import PreTrainedConfig
        from lerobot.policies import factory  # noqa: F401

        found = {field.name for field in fields(PreTrainedConfig.get_choice_class(name))}
        assert set(settings_of(name)) <= found
        hidden = found - set(settings_of(name))
        assert hidden <= {
            *("device", "input_features", "output_features", "use_peft", "pretrained_path", "use_amp"),
            *("pretrained_revision", "push_to_hub", "repo_id", "private", "tags", "license"),
        }  # fmt: skip

    def test_an_unknown_one_is_named_with_the_nearest(self):
        with pytest.raises(UnknownNameError, match=r"LeRobot policy 'smolvl'. Did you mean 'smolvla'\?"):
            train("type=smolvl")


class TestKeys:
    def test_lerobots_own_keys_are_settings(self):
        config = train("type=smolvla", "policy.chunk_size=8", "policy.resize_imgs_with_padding=[64,64]")
        assert config.settings == {"chunk_size": 8, "resize_imgs_with_padding": [64, 64]}

    def test_a_map_of_normalization_is_one_of_them(self):
        config = train("type=xvla", "policy.normalization_mapping={STATE:MEAN_STD,ACTION:MEAN_STD}")
        assert config.settings["normalization_mapping"] == {"STATE": "MEAN_STD", "ACTION": "MEAN_STD"}

    def test_an_unknown_one_is_named_with_the_nearest(self):
        with pytest.raises(ConfigError, match=r"no setting 'chunk_siz'. Did you mean 'chunk_size'"):
            train("type=smolvla", "policy.chunk_siz=8")

    def test_what_the_dataset_decides_is_refused(self):
        with pytest.raises(ConfigError, match=r"policy.input_features is not given by hand"):
            train("type=smolvla", "policy.input_features=[a]")

    def test_the_keys_of_another_policy_stay_as_they_are(self):
        with pytest.raises(UnknownNameError, match=r"Unknown key 'policy.chunk_siz' of train"):
            compose("train", ["policy=act", "policy.chunk_siz=8"])

    def test_peft_is_typed_as_lerobot_has_it(self):
        words = ("policy.path=base", "peft.method_type=LORA", "peft.r=4", "peft.lora_alpha=8",
                 "peft.target_modules=.*q_proj", "peft.full_training_modules=[state_proj]")  # fmt: skip
        assert train(*words).peft == PeftConfig(
            method_type="LORA", r=4, lora_alpha=8, target_modules=".*q_proj",
            full_training_modules=["state_proj"],
        )  # fmt: skip

    @pytest.mark.parametrize(
        ("typed", "layers"),
        [("[q_proj,v_proj]", ["q_proj", "v_proj"]), ("'.*(q_proj|v_proj)'", ".*(q_proj|v_proj)")],
    )
    def test_layers_with_adapters_are_names_or_an_expression(self, typed, layers):
        words = ("policy.path=base", "peft.method_type=LORA", f"peft.target_modules={typed}")
        assert train(*words).peft.target_modules == layers

    @pytest.mark.parametrize(
        ("words", "message"),
        [
            (["type=smolvla", "peft.method_type=LORA"], "adapts a trained policy: give policy.path"),
            (["policy.path=base", "peft.lora_alpha=8"], "has no effect: add peft.method_type=LORA"),
            (["policy.path=base", "peft.r=4"], "add peft.method_type=LORA, or leave out peft.r"),
            (["policy.path=base", "peft.init_type=gaussian"], "or leave out peft.init_type"),
            (["policy.path=base", "peft.r=0"], "must be 1 or more, given 0"),
            (["rename_map={front:a,wrist:a}"], "gives two cameras the same name"),
            (["rename_map=front"], "is no map of names. Write it in quotes, as in"),
        ],
    )
    def test_what_has_no_meaning_is_an_error(self, words, message):
        with pytest.raises(ConfigError, match=message):
            train(*words)

    @pytest.mark.parametrize(
        "text", ["{front:camera1,wrist:camera2}", '{"front": "camera1", "wrist": "camera2"}']
    )
    def test_a_map_of_cameras_is_read_in_hydras_grammar_and_as_json(self, text):
        config = compose("train", ["policy=lerobot", "type=smolvla", f"rename_map={text}"])
        assert config.policy.rename_map == {"front": "camera1", "wrist": "camera2"}
        assert from_values("train", to_values(config)) == config

    def test_names_alone_are_cameras(self):
        assert full_rename_map({"front": "observation.images.camera1"}) == {
            "observation.images.front": "observation.images.camera1"
        }

    def test_python_gives_the_same(self):
        given = {"policy": "lerobot", "policy.type": "smolvla", "policy.chunk_size": 8,
                 "policy.rename_map": {"front": "camera1"}}  # fmt: skip
        config = compose("train", [], given).policy
        assert (config.type, config.settings, config.rename_map) == (
            "smolvla", {"chunk_size": 8}, {"front": "camera1"}
        )  # fmt: skip

    @pytest.mark.parametrize("key", ["checkpoint", "policy.path", "path"])
    def test_evaluate_takes_the_checkpoint_as_lerobot_names_it(self, key):
        config = compose("evaluate", [f"{key}=lerobot/pi05_libero", "rename_map={front:camera1}"])
        assert (config.checkpoint, config.rename_map) == ("lerobot/pi05_libero", {"front": "camera1"})


# --- checkpoints --------------------------------------------------------------------------------------


def test_a_type_that_is_not_registered_is_of_lerobot(tmp_path):
    write(tmp_path, type="smolvla")
    assert (checkpoint.policy_type(tmp_path), checkpoint.policy_label(tmp_path)) == ("lerobot", "smolvla")
    write(tmp_path, type="act")
    assert checkpoint.policy_type(tmp_path) == "act"
    write(tmp_path, model_type="openvla")
    assert checkpoint.policy_type(tmp_path) == checkpoint.policy_label(tmp_path) == "openvla"


def test_cameras_have_the_names_of_the_environment(tmp_path):
    names = {f"observation.images.{name}": image(64) for name in ("camera1", "camera2", "empty_camera_0")}
    write(tmp_path, type="smolvla", input_features=names)
    assert checkpoint.seen_cameras(tmp_path) == {"camera1": 64, "camera2": 64}
    assert checkpoint.seen_cameras(tmp_path, {"front": "camera1"}) == {"front": 64, "camera2": 64}
    saved = {"observation.images.wrist": "observation.images.camera2"}
    steps = [{"registry_name": "rename_observations_processor", "config": {"rename_map": saved}}]
    (tmp_path / "policy_preprocessor.json").write_text(json.dumps({"steps": steps}))
    assert checkpoint.seen_cameras(tmp_path, {"front": "camera1"}) == {"front": 64, "wrist": 64}


def test_the_weights_are_the_network_or_the_adapters_or_an_index(tmp_path):
    assert checkpoint.weights_path(tmp_path).name == "model.safetensors"
    for name in ("model.safetensors.index.json", "adapter_model.safetensors", "model.safetensors"):
        (tmp_path / name).touch()
        assert checkpoint.weights_path(tmp_path).name == name


@pytest.fixture
def foreign(tmp_path):
    return smolvla_base(tmp_path / "smolvla_base")


def test_a_checkpoint_of_others_needs_its_cameras(foreign):
    with pytest.raises(PolicyError, match=r"camera1, camera2, and PickCube has .*'rename_map=\{front:c"):
        evaluate(foreign, "task=PickCube")
    tested = evaluate(foreign, "task=PickCube", "rename_map={front:camera1}")
    assert (tested.env.cameras, tested.env.image_size) == (("front",), 256)
    assert tested.run.endswith("-front=camera1")


def test_actions_of_another_width_are_one_sentence(foreign):
    from roboverse_learn.commands.foreign_checkpoint import check_fits

    tested = evaluate(foreign, "task=PickCube", "rename_map={front:camera1}")
    with pytest.raises(ConfigError, match=r"have 6 numbers, and in PickCube it is 9 \(.*robot franka"):
        check_fits(tested.checkpoint, tested.env, tested.rename_map)


def test_a_type_that_needs_every_camera_is_refused_before_it_is_loaded(foreign):
    from roboverse_learn.commands.foreign_checkpoint import check_fits

    config = json.loads((foreign / "config.json").read_text())
    tested = evaluate(foreign, "task=PickCube", "rename_map={front:camera1}")
    (foreign / "config.json").write_text(json.dumps(config | {"type": "multi_task_dit"}))
    with pytest.raises(
        PolicyError, match=r"sees the cameras front, camera2, and PickCube has front: camera2 is"
    ):
        check_fits(tested.checkpoint, tested.env, tested.rename_map)


def test_the_policy_that_is_named_must_be_the_checkpoints(foreign):
    assert evaluate(foreign, "policy=lerobot", "task=PickCube", "rename_map={front:camera1}")
    with pytest.raises(ConfigError, match=r"policy=openvla and checkpoint=.*is of policy=lerobot"):
        evaluate(foreign, "policy=openvla", "task=PickCube")


class TestPreflight:
    """What is known before demonstrations are collected."""

    def test_a_missing_package_is_named_with_what_to_install(self, monkeypatch):
        monkeypatch.setattr(preflight, "find_spec", lambda name: None)
        with pytest.raises(
            MissingExtraError,
            match=f"smolvla needs transformers and num2words: {re.escape(install_command('vla'))}",
        ):
            check("type=smolvla")
        check("type=vqbet")  # which needs none

    @pytest.mark.parametrize(
        ("type_name", "absent"),
        [("groot", "tree"), ("groot", "diffusers"), ("wall_x", "torchdiffeq"), ("wall_x", "qwen_vl_utils"),
         ("wall_x", "peft"), ("smolvla", "num2words"), ("multi_task_dit", "diffusers"),
         ("vla_jepa", "diffusers"), ("fastwam", "diffusers"), ("lingbot_va", "diffusers")],
    )  # fmt: skip
    def test_a_package_that_only_one_type_needs_is_named(self, type_name, absent, monkeypatch):
        monkeypatch.setattr(preflight, "find_spec", lambda name: None if name == absent else name)
        with pytest.raises(
            MissingExtraError,
            match=f"LeRobot's {type_name} needs {absent}: {re.escape(install_command('vla'))}",
        ):
            check(f"type={type_name}")
        check("type=xvla")  # which does not need it

    @pytest.mark.parametrize(
        ("type_name", "setting"),
        [("lingbot_va", "policy.attn_mode=flex"), ("molmoact2", "policy.inference_action_mode=continuous")],
    )
    def test_what_cannot_be_trained_or_act_as_it_is_set_is_refused(self, type_name, setting, monkeypatch):
        monkeypatch.setattr(preflight, "find_spec", lambda name: name)
        with pytest.raises(PolicyError, match=rf"LeRobot.*{type_name}.*Add {setting}"):
            check(f"type={type_name}")
        check(f"type={type_name}", setting)

    def test_the_cameras_of_the_checkpoint_are_those_of_the_task(self, foreign, monkeypatch):
        monkeypatch.setattr(preflight, "find_spec", lambda name: name)
        with pytest.raises(
            PolicyError, match=r"camera1, camera2, and the dataset has front: camera1, camera2 are"
        ):
            check(f"policy.path={foreign}", "cameras=[front]")
        check(f"policy.path={foreign}", "cameras=[front]", "rename_map={front:camera2}")

    def test_the_settings_are_those_of_its_type(self, foreign, monkeypatch):
        monkeypatch.setattr(preflight, "find_spec", lambda name: name)
        with pytest.raises(PolicyError, match="smolvla has no setting 'florence_config'"):
            check(f"policy.path={foreign}", "policy.florence_config=1")
        with pytest.raises(PolicyError, match="is of type smolvla, and type=xvla was given"):
            check(f"policy.path={foreign}", "type=xvla")

    @pytest.mark.parametrize(
        ("content", "said"),
        [
            ({}, r"'gr00t' is no checkpoint of LeRobot's: its config\.json has no type\. Give"),
            ({"model_type": "gr00t_n1_5"}, r"has no type, and its model_type is gr00t_n1_5\. Give"),
        ],
    )
    def test_a_network_of_another_program_is_given_as_what_a_type_begins_with(
        self, content, said, tmp_path, monkeypatch
    ):
        monkeypatch.chdir(tmp_path)
        write(tmp_path / "gr00t", **content)
        (tmp_path / "gr00t" / "model.safetensors").write_bytes(b"weights")
        with pytest.raises(PolicyError, match=said + r".* type=groot policy\.base_model_path=gr00t"):
            check("policy.path=gr00t")

    @pytest.mark.parametrize("policy", ["octo", "openvla"])
    def test_a_checkpoint_of_another_policy_here_names_that_policy(self, policy, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        write(tmp_path / "saved", model_type=policy)
        (tmp_path / "saved" / "model.safetensors").write_bytes(b"weights")
        with pytest.raises(PolicyError, match=rf"is of {policy}: give policy={policy} policy\.path=saved\."):
            check("policy.path=saved")

    def test_a_setting_that_lerobots_preset_decides_is_refused(self):
        check("type=vqbet", "preset=gpu")
        for word in ("train.lr=1e-3", "train.betas=[0.5,0.9]"):
            with pytest.raises(PolicyError, match=r"would have no effect: LeRobot's preset.* or add policy"):
                check("type=vqbet", word)
            check("type=vqbet", word, "policy.use_policy_training_preset=false")

    def test_a_checkpoint_without_its_assets_is_refused(self, foreign, monkeypatch):
        monkeypatch.setattr(preflight, "find_spec", lambda name: name)
        (foreign / "assets.json").write_text('{"owner/backbone": "assets/backbone"}')
        said = r"smolvla_base' has no assets/backbone, which its assets\.json names: .* with its assets\."
        with pytest.raises(PolicyError, match=said):
            check(f"policy.path={foreign}", "rename_map={front:camera1}")
        with pytest.raises(PolicyError, match=said):
            policies.load(foreign)
        (foreign / "assets" / "backbone").mkdir(parents=True)
        check(f"policy.path={foreign}", "rename_map={front:camera1}")

    def test_neither_a_type_nor_a_checkpoint_is_refused_before_lerobots_policies_are_imported(self):
        with pytest.raises(
            PolicyError, match=r"needs type=<name>, as in type=smolvla.*Types: act, diffusion"
        ):
            check()


def test_a_policy_without_a_type_says_which_there_are():
    with pytest.raises(PolicyError, match=r"needs type=<name>, as in type=smolvla.*Types: act, diffusion"):
        policies.create("lerobot", FEATURES, stats(), LeRobotConfig())
