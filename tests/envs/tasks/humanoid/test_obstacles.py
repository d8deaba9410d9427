"""The further locomotion tasks: scenes by their published dimensions, rewards written out by hand, ends."""

import dataclasses

import mujoco
import numpy as np
import pytest
import torch

from envs.core.errors import SimulatorError
from envs.simulators.mujoco.handler import MujocoHandler
from envs.state import EntityState, State
from envs.tasks import TASKS
from tests.envs.tasks.humanoid.published import (
    Published,
    gaussian,
    linear,
    needs_assets,
    published_model,
    put,
)

NAMES = (
    *("crawl", "hurdle", "stair", "slide", "pole", "maze"),
    *("sit_simple", "sit_hard", "balance_simple", "balance_hard"),
)

ROWS = 6


def task_of(name):
    return TASKS.get(f"humanoid/{name}")()


def started(task, seed=0):
    """A handler with one environment at the start of an episode."""
    handler = MujocoHandler(task.scenario, 1, num_threads=1)
    handler.launch()
    handler.set_states(task.initial_state([np.random.default_rng(seed)]))
    return handler


def moved(handler, dx=0.0, dy=0.0, dz=0.0):
    """Puts the robot elsewhere, steps once, and returns the state."""
    state = handler.get_states()
    state.robots["h1"].pos[:] += torch.tensor([dx, dy, dz])
    handler.set_states(State(state.robots, {}))
    handler.step(1)
    return handler.get_states()


@pytest.fixture(scope="module")
def postures():
    """States of random actions on bare ground."""
    task, rng = TASKS.get("humanoid/walk")(), np.random.default_rng(1)
    with started(task) as handler:
        states = [handler.get_states()]
        for _ in range(ROWS - 1):
            task.controller.apply(handler, rng.uniform(-0.4, 0.4, (1, 19)))
            handler.step(150)
            states.append(handler.get_states())
    flat = [state.flatten() for state in states]
    return State.unflatten({key: torch.cat([values[key] for values in flat]) for key in flat[0]})


def beside(postures, touched=0.0, **objects):
    """The same postures with objects, each felt or not."""
    robot = dataclasses.replace(postures.robots["h1"])
    robot.touched = torch.full((ROWS, 2), touched, dtype=torch.float64)
    entities = {}
    for name, pos in objects.items():
        entity = EntityState.at_rest(np.tile(np.array(pos, float), (ROWS, 1)), np.array([1.0, 0.0, 0.0, 0.0]))
        entity.touched = torch.full((ROWS, 1), touched, dtype=torch.float64)
        entities[name] = entity
    return State({"h1": robot}, entities)


def by_hand(name, p, pos, touched):
    """The published reward of one state."""
    discount = 0.1 if touched else 1.0
    if name == "crawl":
        low = min(gaussian(max(0.6 - z, z - 1.0), 1.0) for z in (p.imu[2], p.head))
        posture = gaussian(np.linalg.norm(p.pelvis - np.array([0.75, 0, 0.65, 0])), 1.0)
        inside = float(-1 <= p.imu[1] <= 1)
        return (0.1 * p.small_control + 0.25 * low + 0.4 * p.move(1.0) + 0.25 * posture) * inside
    if name == "hurdle":
        return p.small_control * p.stand_reward(0.8) * p.move(5.0) * discount
    if name in ("stair", "slide"):
        tall = np.prod([gaussian(1.2 - (p.head - foot), 0.45) for foot in p.feet])
        return tall * linear(0.5 - p.upright, 1.9) * p.small_control * p.move(1.0)
    if name == "pole":
        return (0.5 * p.small_control * p.stand_reward() + 0.5 * p.move(0.5)) * discount
    if name == "maze":  # on the way from (0, 0) to the marker at (3, 0), at 2 m/s along x
        move = np.prod([max(0.0, 1.0 - abs(off)) for off in p.velocity[:2] - (2.0, 0.0)])
        near = gaussian(np.linalg.norm(p.imu[:2] - (3.0, 0.0)), 1.0)
        return (0.2 * p.small_control * p.stand_reward() + 0.4 * (5 * move + 1) / 6 + 0.4 * near) * discount
    if name.startswith("sit"):
        sitting = gaussian(max(0.68 - pos[2], pos[2] - 0.72), 0.2)
        on_chair = gaussian(abs(pos[0] + 0.25) - 0.19, 0.2) * gaussian(abs(pos[1]), 0.1)
        bent = p.head - p.imu[2]
        posture = gaussian(max(0.35 - bent, bent - 0.45), 0.3)
        upright = linear(0.95 - p.upright, 0.9)
        return p.small_control * (0.5 * sitting + 0.5 * on_chair) * upright * posture * p.still()
    return p.small_control * p.stand_reward(height=1.65 + 0.37) * p.still()


@needs_assets
@pytest.mark.parametrize("touched", [0.0, 1.0])
@pytest.mark.parametrize("name", NAMES)
def test_rewards_are_those_written_out_by_hand(name, touched, postures):
    things = {"walls": (0, 0, 0), "poles": (0, 0, 0), "chair": (-0.25, 0, 0)}
    state = beside(postures, touched, maze=(0, 0, 0), checkpoint=(3, 0, 1), **things)
    reward = task_of(name).reward(state)
    model = published_model()
    data = mujoco.MjData(model)
    for row in range(ROWS):
        put(model, data, postures.select([row]))
        expected = by_hand(name, Published(data), data.qpos[:3], touched)
        assert reward[row].item() == pytest.approx(expected, abs=1e-9), row


@pytest.mark.parametrize(
    ("name", "things"), [("sit_hard", {"chair": 15.748}), ("balance_hard", {"board": 19.8, "ball": 20.58})]
)
def test_what_moves_has_the_published_mass(name, things):
    with started(task_of(name)) as handler:
        for thing, mass in things.items():
            assert handler.model.body(thing).mass[0] == pytest.approx(mass, abs=0.01)


def test_scenes_have_the_published_parts():
    counts = {
        "hurdle": ("hurdles", 10),
        "stair": ("stairs", 20),
        "pole": ("poles", 144),
        "maze": ("maze", 30),
    }
    for name, (thing, count) in counts.items():
        assert len(task_of(name).scenario.object(thing).geoms) == count
    with started(task_of("slide")) as handler:
        assert handler.model.body("slides/slides").geomnum[0] == 9


@pytest.mark.slow
def test_initial_state_has_no_collisions():
    for name in NAMES:
        with started(task_of(name)) as handler:
            robot = {
                int(b) for b in range(handler.model.nbody) if handler.model.body(b).name.startswith("h1/")
            }
            data = mujoco.MjData(handler.model)
            data.qpos[:], data.mocap_pos[:] = handler._qpos[0], handler._mocap_pos[0]
            data.mocap_quat[:] = handler._mocap_quat[0]
            mujoco.mj_forward(handler.model, data)
            for contact in data.contact:
                bodies = {int(handler.model.geom_bodyid[geom]) for geom in contact.geom}
                assert not bodies & robot or contact.dist > -0.03, name


@pytest.mark.parametrize(
    ("name", "thing", "shift"), [("hurdle", "walls", (0, 4.3)), ("pole", "poles", (2.0, 0.0))]
)
def test_touching_what_one_should_not_costs_nine_tenths(name, thing, shift):
    task = task_of(name)
    with started(task) as handler:
        free = moved(handler)
        assert not free.objects[thing].touched.any()
        hit = moved(handler, *shift)
        assert hit.objects[thing].touched.all()
        spared = State(hit.robots, {thing: hit.objects[thing].select(torch.tensor([0]))})
        spared.objects[thing].touched = torch.zeros((1, 1), dtype=torch.float64)
        assert task.reward(hit).item() == pytest.approx(0.1 * task.reward(spared).item())


def test_balance_is_lost_where_the_robot_or_the_board_touches_the_ground():
    task = task_of("balance_simple")
    with started(task) as handler:
        assert not task.failure(moved(handler)).any()
        assert task.failure(moved(handler, dx=2.0, dz=-0.45)).all()  # on the ground beside it
        state = handler.get_states()
        board = state.objects["board"]
        board.pos[:] = torch.tensor([3.0, 0.0, 0.03])
        handler.set_states(State(task.initial_state([np.random.default_rng(0)]).robots, {"board": board}))
        handler.step(1)
        state = handler.get_states()
        assert state.objects["board"].touched.all()
        assert task.failure(state).all()


def test_falls_end_the_tasks_that_say_so(postures):
    fallen = postures.robots["h1"].pos[:, 2] < 0.5
    assert fallen.any() and not fallen.all()
    assert torch.equal(task_of("pole").failure(postures), fallen)
    assert torch.equal(task_of("sit_simple").failure(postures), fallen)
    assert not task_of("crawl").failure(postures).any()
    lying = task_of("walk").measures(postures).upright < 0.1
    assert torch.equal(task_of("stair").failure(postures), lying)


def test_a_maze_is_walked_from_checkpoint_to_checkpoint():
    """Each control step the marker moves on, the robot arrives, and gets the reward."""
    task, bonuses, seen = task_of("maze"), [], []
    with started(task) as handler:
        hold = task.controller.hold(handler.get_states())
        controller = task.controller
        for x, y in ((0, 0), (1.5, 0), (3, 0), (3, 3), (3, 6), (6, 6), (6, 6)):
            controller.apply(handler, hold)
            seen.append(handler.get_states().objects["checkpoint"].pos[0].tolist())
            robot = handler.get_states().robots["h1"]
            robot.pos[:, :2] = torch.tensor([x, y], dtype=torch.float64)
            handler.set_states(State({"h1": robot}, {}))
            handler.step(1)
            bonuses.append(round(task.reward(handler.get_states()).item() // 100))
    assert bonuses == [1, 0, 2, 0, 3, 4, 0]
    assert seen == [[0, 0, 1], [3, 0, 1], [3, 0, 1], [3, 6, 1], [3, 6, 1], [6, 6, 1], [6, 6, -1]]


def test_sitting_down_starts_anywhere_before_the_chair():
    state = task_of("sit_hard").initial_state([np.random.default_rng(i) for i in range(64)])
    x, y = state.robots["h1"].pos[:, 0], state.robots["h1"].pos[:, 1]
    assert (x >= 0.2).all() and (x <= 0.4).all() and x.std() > 0.04
    assert (y.abs() <= 0.15).all() and y.std() > 0.06
    assert state.objects["chair"].pos[:, 0].std() > 0.003


def test_simulator_without_contact_sensors_is_refused(postures):
    state = beside(postures, poles=(0, 0, 0))
    state.objects["poles"].touched = None
    with pytest.raises(SimulatorError, match="needs contacts, which this simulator does not report"):
        task_of("pole").reward(state)


@pytest.mark.parametrize("name", NAMES)
def test_no_constant_stays_on_the_cpu(name, postures):
    state = beside(
        postures, walls=(0, 0, 0), poles=(0, 0, 0), maze=(0, 0, 0), chair=(0, 0, 0), board=(0, 0, 0),
        ball=(0, 0, 0), checkpoint=(0, 0, 1),
    )  # fmt: skip
    task = task_of(name)
    for function in (task.reward, task.failure, task.success, task.observe):
        assert function(state.to("meta", torch.float32)).device.type == "meta"
