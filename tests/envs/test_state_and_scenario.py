"""States, scenarios, registries, assets."""

import re

import numpy as np
import pytest
import torch

from envs.core.assets import resolve
from envs.core.errors import ConfigError, MissingExtraError, UnknownNameError, suggest
from envs.core.extras import install_command
from envs.core.registry import Registry
from envs.scenario import GeomCfg, LinkCfg, ObjectCfg, PhysicsCfg, ScenarioCfg
from envs.state import EntityState, State


def nested():
    return {
        "robots": {"arm": {"pos": torch.zeros(2, 3), "rot": torch.ones(2, 4), "joint_pos": torch.ones(2, 5)}},
        "objects": {"cube": {"pos": torch.arange(6.0).reshape(2, 3), "rot": torch.ones(2, 4)}},
    }


def test_the_nested_form_fills_in_what_is_absent():
    state = State.from_dict(nested())
    assert state.num_envs == 2
    assert state.robots["arm"].joint_vel.shape == (2, 5)
    assert state.objects["cube"].joint_pos.shape == (2, 0)
    assert (state.objects["cube"].lin_vel == 0).all()
    again = State.from_dict(state.to_dict())
    assert torch.equal(again.objects["cube"].pos, state.objects["cube"].pos)


def test_flattening_is_undone():
    state = State.from_dict(nested())
    again = State.unflatten(state.flatten())
    assert again.flatten().keys() == state.flatten().keys()
    assert "robots/arm/joint_pos" in state.flatten()


def test_selection_copies():
    state = State.from_dict(nested())
    part = state.select([1])
    part.objects["cube"].pos[:] = -1.0
    assert state.objects["cube"].pos[1].tolist() == [3.0, 4.0, 5.0]


def test_states_say_what_is_wrong():
    bad = nested()
    bad["objects"]["cube"]["posn"] = bad["objects"]["cube"].pop("pos")
    with pytest.raises(
        UnknownNameError, match=r"Unknown field of 'cube' in a state 'posn'. Did you mean 'pos'"
    ):
        State.from_dict(bad)
    del bad["objects"]["cube"]["posn"]
    with pytest.raises(ConfigError, match="The state of 'cube' lacks pos"):
        State.from_dict(bad)


def test_scenarios_refuse_double_names_and_wrong_sizes():
    cube = ObjectCfg(name="cube", geoms=(GeomCfg(shape="box", size=(0.1, 0.1, 0.1), mass_kg=1.0),))
    with pytest.raises(ConfigError, match="names must be unique; used twice: cube"):
        ScenarioCfg(objects=(cube, cube))
    with pytest.raises(ConfigError, match="A sphere has 1 positive sizes, given"):
        GeomCfg(shape="sphere", size=(0.1, 0.1))
    with pytest.raises(ConfigError, match="Object 'ball' is free, so a geom of its root needs mass"):
        ObjectCfg(name="ball", geoms=(GeomCfg(shape="sphere", size=(0.1,)),))
    with pytest.raises(UnknownNameError, match="Unknown parent of link 'b' of object 'box' 'c'"):
        ObjectCfg(name="box", links=(LinkCfg(name="b", geoms=(), parent="c"),), kind="fixed")


def test_control_frequency():
    assert PhysicsCfg(timestep_s=0.002, decimation=25).control_hz == pytest.approx(20.0)


def test_a_registry_imports_late_and_explains():
    registry: Registry[type] = Registry("thing")
    registry.add("ordered", "collections:OrderedDict", tags={"dict"})
    registry.add("absent", "no_such_package:Thing", extra="things")
    assert registry.names("dict") == ["ordered"]
    assert registry.get("ordered").__name__ == "OrderedDict"
    with pytest.raises(
        UnknownNameError, match=r"Unknown thing 'orderd'\. Did you mean 'ordered'\? Valid: absent, ordered"
    ):
        registry.get("orderd")
    with pytest.raises(
        MissingExtraError,
        match=f"needs the package 'no_such_package'.*{re.escape(install_command('things'))}",
    ):
        registry.get("absent")
    with pytest.raises(ValueError, match="'ordered' is registered already"):
        registry.add("ordered", int)


def test_suggestions_ignore_case():
    assert suggest("pickcube", ["PickCube", "StackCube"]) == " Did you mean 'PickCube'?"
    assert suggest("zzz", ["PickCube"]) == ""
    assert suggest("STPES", ["steps"], {"steps": "train.steps"}) == " Did you mean 'train.steps'?"


def test_assets_say_what_is_missing():
    with pytest.raises(MissingExtraError, match="part of the package 'nowhere', which is not installed"):
        resolve("nowhere:a.xml")
    with pytest.raises(MissingExtraError, match=r"part of the package 'nowhere\.at_all', which"):
        resolve("nowhere.at_all:a.xml")
    with pytest.raises(ConfigError, match="does not exist: there is no file"):
        resolve("robosuite:models/none.xml")


def test_a_path_may_hold_a_colon(tmp_path):
    file = tmp_path / "12:30.xml"
    file.touch()
    assert resolve(str(file)) == file
    with pytest.raises(
        ConfigError, match=r"The asset ':a.xml' does not exist: there is no file /.*/:a\.xml\."
    ):
        resolve(":a.xml")


def test_a_state_moves_to_another_precision_and_back():
    state = State({}, {"cube": EntityState.at_rest(np.full((2, 3), 0.1), np.tile([1.0, 0, 0, 0], (2, 1)))})
    single = state.to("cpu", torch.float32)
    assert single.objects["cube"].pos.dtype == torch.float32
    assert single.objects["cube"].joint_target is None
    back = single.to("cpu")
    assert back.objects["cube"].pos.dtype == torch.float64
    np.testing.assert_allclose(back.objects["cube"].pos, 0.1, atol=1e-8)
    assert state.to("cpu").objects["cube"].pos is state.objects["cube"].pos
