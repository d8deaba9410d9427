"""The check of conversions: what it finds, and what it says."""

import dataclasses

import numpy as np
import pytest

from envs.convert import check as module
from envs.convert.check import Errors, Row, compare, installed, page, robosuite_files, table
from envs.convert.conversion import convert, describe_loaded
from envs.convert.readers import MujocoReader
from envs.convert.source import load

SMALL = Errors(position_m=1e-7, rotation_rad=1e-7, mass=0.0, inertia=1e-9)


@pytest.mark.parametrize(
    ("changes", "passes"),
    [
        ({}, True),
        ({"position_m": 2e-5}, False),
        ({"mass": 2e-6}, False),
        ({"inertia": 2e-6}, False),
        ({"rotation_rad": 0.1}, True),  # links that are far out say so by their position
    ],
)
def test_a_row_passes_within_the_limits(changes, passes):
    errors = dataclasses.replace(SMALL, **changes)
    assert errors.passed is passes
    assert Row("arm", "MuJoCo", errors).verdict == ("pass" if passes else "fail")


def test_what_cannot_be_converted_fails_with_its_reason():
    assert Row("arm", "MuJoCo", None, "no such file").verdict == "fail"


class Shifted(MujocoReader):
    """Reads a robot wrongly: one link lies elsewhere, and weighs more."""

    def poses(self, joints):
        poses = super().poses(joints)
        pos, rot = poses["finger"]
        return {**poses, "finger": (pos + np.array([0.0, 0.003, 0.004]), rot)}

    def inertials(self):
        found = super().inertials()
        heavier = dataclasses.replace(found["base"], mass=found["base"].mass + 1.0)
        return {**found, "base": heavier}


def test_a_link_that_lies_or_weighs_wrong_is_found(hard_robot):
    loaded = load(hard_robot)
    description = describe_loaded(loaded)
    path = convert(hard_robot)
    right = compare(loaded, description, MujocoReader(path), 5)
    wrong = compare(loaded, description, Shifted(path), 5)
    assert right.passed and not wrong.passed
    assert wrong.position_m == pytest.approx(0.005)
    assert wrong.mass == pytest.approx(1.0 / loaded.model.body_mass.sum())
    assert wrong.inertia == right.inertia


def test_all_that_robosuite_ships_is_checked():
    names = [path.parent.name if path.stem == "robot" else path.stem for path in robosuite_files()]
    assert {"panda", "sawyer", "ur5e", "gr1"} <= set(names[:11])
    assert {"panda_gripper", "robotiq_gripper_140", "omron_mobile_base"} <= set(names)
    assert "MuJoCo" in installed()


def test_the_page_counts_and_tells_why():
    rows = [
        Row("arm", "MuJoCo", SMALL, links=3, joints=2),
        Row("hand", "MuJoCo", None, "repeated name | in mesh"),
    ]
    written = page(rows, 1000, "the command")
    assert "**1 of 2 pass.**" in written and "`the command`" in written and "1,000" in written
    assert table(rows).splitlines()[2] == ("| arm | 3, 2 | MuJoCo | 1e-07 | 1e-07 | 0 | 1e-09 | pass |  |")
    assert table(rows).splitlines()[3].endswith("| fail | repeated name / in mesh |")


def test_the_program_writes_the_page_and_fails_where_a_robot_does(hard_robot, tmp_path, monkeypatch):
    kept = tmp_path / "page.md"
    words = [str(hard_robot), "--programs", "MuJoCo", "--postures", "3"]
    assert module.main([*words, "--write", str(kept)]) == 0
    assert "| hard | 6, 6 | MuJoCo |" in kept.read_text()
    monkeypatch.setitem(module.READERS, "MuJoCo", ("urdf", "mujoco", Shifted))
    assert module.main(words) == 1


def test_postures_stay_within_the_ranges(hard_robot):
    seen = []

    class Watching(MujocoReader):
        def poses(self, joints):
            seen.append(dict(joints))
            return super().poses(joints)

    loaded = load(hard_robot)
    compare(loaded, describe_loaded(loaded), Watching(convert(hard_robot)), 20)
    pans = np.array([joints["pan"] for joints in seen])
    assert len(pans) == 20 and pans.min() >= -1.0 and pans.max() <= 2.0 and np.ptp(pans) > 1.0
