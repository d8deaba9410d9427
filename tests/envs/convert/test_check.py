"""The check of conversions: what it finds, and what it says."""

import dataclasses

import numpy as np
import pytest

from docs.generate.conversion import check as module
from docs.generate.conversion.check import check, compare, installed, robosuite_files
from docs.generate.conversion.readers import MujocoReader
from docs.generate.conversion.table import Errors, Row, merged, page, read_rows, table, write_rows
from envs.convert.conversion import convert, describe_loaded
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
    """Reads a robot wrongly: one link is displaced and heavier."""

    def poses(self, joints):
        poses = super().poses(joints)
        pos, rot = poses["finger"]
        return {**poses, "finger": (pos + np.array([0.0, 0.003, 0.004]), rot)}

    def inertials(self):
        found = super().inertials()
        heavier = dataclasses.replace(found["base"], mass=found["base"].mass + 1.0)
        return {**found, "base": heavier}


def test_wrong_pose_or_mass_of_a_link_is_reported(hard_robot):
    loaded = load(hard_robot)
    description = describe_loaded(loaded)
    path = convert(hard_robot)
    right, nothing = compare(loaded, description, MujocoReader(path), 5)
    wrong, note = compare(loaded, description, Shifted(path), 5)
    assert right.passed and nothing == ""
    assert not wrong.passed
    assert wrong.position_m == pytest.approx(0.005)
    assert wrong.mass == pytest.approx(1.0 / loaded.model.body_mass.sum())
    assert wrong.inertia == right.inertia
    assert note.startswith("'finger' is off by up to 0.005 m. 'base' is of another mass: ")


def test_all_that_robosuite_and_robosuite_models_ship_is_checked():
    names = [path.parent.name if path.stem == "robot" else path.stem for path in robosuite_files()]
    assert len(set(names)) == len(names)
    assert {"panda", "sawyer", "ur5e", "gr1"} <= set(names[:11])
    assert {"panda_gripper", "robotiq_gripper_140", "omron_mobile_base"} <= set(names)
    assert "MuJoCo" in installed()
    pytest.importorskip("robosuite_models")
    assert {"h1", "g1", "pr2", "umi_gripper", "aloha_mount"} <= set(names)


@pytest.mark.parametrize(("program", "module"), [("PyBullet", "pybullet"), ("SAPIEN", "sapien")])
def test_simulators_read_a_hard_robot_as_it_is(hard_robot, program, module):
    pytest.importorskip(module)
    (row,) = check(hard_robot, programs=[program], postures=20)
    assert row.verdict == "pass", row
    assert row.version and row.postures == 20


ROWS = (
    Row("arm", "MuJoCo", SMALL, links=3, joints=2, postures=1000, version="4.0"),
    Row("arm", "SAPIEN", dataclasses.replace(SMALL, mass=0.5), "'tip' is of another mass.", ("No ropes.",)),
    Row("hand", "MuJoCo", None, "repeated name | in mesh"),
    Row("hand", "SAPIEN", None, "repeated name | in mesh"),
)


def test_table_has_a_row_per_robot_with_the_reason_of_a_failure():
    lines = table(ROWS).splitlines()
    assert lines[0] == "| robot | links, joints | MuJoCo | SAPIEN | note |"
    assert lines[2] == (
        "| arm | 3, 2 | 1e-07 m, 1e-09 | **fail**: 1e-07 m, 5e-01 "
        "| SAPIEN: 'tip' is of another mass. No ropes. |"
    )
    assert lines[3] == "| hand |  | **fail** | **fail** | repeated name / in mesh |"
    assert "not run" in table(ROWS[:3]).splitlines()[3]


def test_the_page_counts_by_program():
    written = page(ROWS, "the command", "rows.json")
    assert "| MuJoCo 4.0 | 1 | 1 |" in written and "| SAPIEN | 0 | 2 |" in written
    assert "`the command`" in written and "1,000 random postures" in written


def test_rows_are_kept_and_a_new_one_takes_the_place_of_its_old_one(tmp_path):
    kept = tmp_path / "rows.json"
    assert read_rows(kept) == []
    write_rows(kept, ROWS)
    assert read_rows(kept) == list(ROWS)
    better = Row("hand", "MuJoCo", SMALL)
    rows = merged(read_rows(kept), [better])
    assert len(rows) == 4 and rows[2] == better


def test_the_program_writes_the_page_and_fails_where_a_robot_does(hard_robot, tmp_path, monkeypatch):
    kept = tmp_path / "page.md"
    words = [f"robots=[{hard_robot}]", "programs=[MuJoCo]", "postures=3"]
    assert module.main([*words, f"write={kept}"]) == 0
    assert "| hard | 6, 6 |" in kept.read_text()
    assert [row.robot for row in read_rows(tmp_path / "page.json")] == ["hard"]
    monkeypatch.setitem(module.READERS, "MuJoCo", ("urdf", "mujoco", "mujoco", Shifted))
    assert module.main(words) == 1


def test_a_program_that_reads_no_robot_is_named(capsys):
    assert module.main(["programs=[MuJoCoo]"]) == 2
    assert (
        "error: Unknown program that reads robots 'MuJoCoo'. Did you mean 'MuJoCo'?"
        in capsys.readouterr().err
    )


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
