"""LIBERO-PRO's variants: what is registered, what its files say, and that a task of it is solved."""

import numpy as np
import pytest

import envs
from docs.generate.libero_catalogue import pro_catalogue_text
from envs.core.errors import ConfigError, MissingExtraError
from envs.experts.actor import expert_episodes
from envs.tasks import TASKS
from envs.tasks.libero import files
from envs.tasks.libero.catalogue import PRO_CATALOGUE, PRO_SUITES, VARIANTS, entries, pro_entries
from envs.tasks.libero.same_scene import same_scene_tasks
from envs.tasks.libero.scene import scene_of
from envs.tasks.libero.start_files import fixed_starts
from envs.tasks.libero_objects import read_init_states
from envs.tasks.suites import SUITES, suite_tasks

STOVE = "libero_pro/goal_object/turn_on_the_stove"


@pytest.fixture
def installed():
    try:
        files.problem_file(pro_entries()[STOVE])
    except MissingExtraError as error:
        pytest.skip(str(error))


def test_160_tasks_in_16_suites_are_registered_with_their_own_extra():
    assert len(pro_entries()) == 160 and not set(pro_entries()) & set(entries())
    assert all(TASKS.entry(name).extra == "libero-pro" for name in pro_entries())
    suites = [f"libero_pro/{suite}_{variant}" for suite in PRO_SUITES for variant in VARIANTS]
    assert set(suites) <= set(SUITES) and len(suites) == 16
    assert {name for suite in suites for name in suite_tasks(suite)} == set(pro_entries())


def test_a_variant_keeps_the_order_of_its_suite_and_other_words_are_other_words():
    own = [entry.file for entry in entries().values() if entry.suite == "goal"]
    assert [pro_entries()[name].file for name in suite_tasks("libero_pro/goal_lan")] == own
    words = {entry.file: entry.instruction for entry in entries().values() if entry.suite == "goal"}
    other = [pro_entries()[name] for name in suite_tasks("libero_pro/goal_lan")]
    assert all(entry.instruction != words[entry.file] for entry in other)


def test_the_catalogue_is_that_of_the_installed_files(installed):
    assert PRO_CATALOGUE.read_text(encoding="utf-8") == pro_catalogue_text(), (
        "python -m docs.generate.libero_catalogue"
    )


def test_without_the_extra_the_error_has_its_name(monkeypatch):
    def absent(reference):
        raise ConfigError(reference)

    monkeypatch.setattr(files, "resolve", absent)
    with pytest.raises(MissingExtraError, match=r"'libero:.*goal_object/turn_on.*\[libero-pro\]"):
        files.problem_file(pro_entries()[STOVE])


def test_things_that_changed_places_begin_at_each_others_places(installed):
    """In ``goal_swap/push_the_plate…`` the plate and the wine bottle have changed their regions."""
    file = "push_the_plate_to_the_front_of_the_stove"
    own = scene_of(entries()[f"libero/goal/{file}"]).problem.init
    swapped = scene_of(pro_entries()[f"libero_pro/goal_swap/{file}"]).problem.init
    (plate,) = {atom.args for atom in swapped if atom.args[0] == "plate_1"}
    (bottle,) = {atom.args for atom in own if atom.args[0] == "wine_bottle_1"}
    assert plate[1] == bottle[1]


def test_start_states_are_read_without_a_pickle_and_another_width_is_refused(installed):
    entry = pro_entries()[STOVE]
    scene = scene_of(entry)
    starts = fixed_starts(entry, scene)
    assert starts.num_envs == 50 and set(starts.objects) >= set(scene.problem.objects)
    with pytest.raises(ConfigError, match=r"\.npz: its initial states are 50 × 79 numbers; rows of 80 fit"):
        read_init_states(files.start_file(entry), 80)


@pytest.mark.parametrize("content", ["nothing", "no array", "objects", "not finite"])
def test_a_damaged_file_of_start_states_is_one_sentence(tmp_path, content):
    path = tmp_path / "a.pruned_init.npz"
    if content == "nothing":
        path.write_bytes(b"")
    elif content == "no array":
        np.savez(path, other=np.zeros((2, 4)))
    elif content == "objects":
        np.savez(path, states=np.array([{"a": 1}], dtype=object), allow_pickle=True)
    else:
        np.savez(path, states=np.full((2, 4), np.nan))
    with pytest.raises(ConfigError, match=r"a\.pruned_init\.npz (is not LIBERO's|has no)") as error:
        read_init_states(path, 4)
    assert "\n" not in str(error.value)


def test_other_tasks_of_a_scene_are_of_the_same_variant(installed):
    found = same_scene_tasks(pro_entries()["libero_pro/goal_lan/turn_on_the_stove"])
    assert found and all(name.startswith("libero_pro/goal_lan/") for name in found)


@pytest.mark.slow
def test_the_expert_turns_on_the_stove_of_another_colour(installed):
    env = envs.make_vec(STOVE, 1, split="test", observation="state", num_threads=1)
    try:
        (episode,) = expert_episodes(env, env.split_indices[:1].tolist(), record=())
        assert episode.success
    finally:
        env.close()
