"""What a headset's controller moves, by poses that are worked out by hand."""

import json
import math

import pytest

from tests.roboverse_learn.teleoperation import node

pytestmark = pytest.mark.skipif(node.PROGRAM is None, reason="no Node is installed")

HALF = math.sqrt(0.5)


@pytest.fixture(scope="module")
def motion(tmp_path_factory):
    folder = node.page_folder(tmp_path_factory.mktemp("page"))
    return lambda expression: node.evaluated(folder, "headset_motion.js", expression)


def pose(*position, turn=(0.0, 0.0, 0.0, 1.0)):
    return {"position": position, "orientation": turn}


def about(axis, radians):
    """Returns the quaternion [x, y, z, w] of a turn about an axis of WebXR."""
    turn = [0.0, 0.0, 0.0, math.cos(radians / 2)]
    turn["xyz".index(axis)] = math.sin(radians / 2)
    return tuple(turn)


def followed(motion, *poses, metres=1.0, radians=4.0, scale=1.0):
    """Returns the motion for each pose of a controller that is held."""
    limits = {"metres": metres, "radians": radians, "scale": scale}
    given = json.dumps([list(poses), limits])
    follow = (
        "(clutch, [poses, limits]) => poses.map((pose) => pose ? clutch.follow(pose, limits) : clutch.drop())"
    )
    return motion(f"({follow})(new m.Clutch(), {given})")


def test_ahead_of_the_person_is_away_from_the_camera(motion):
    assert motion("m.handMotion([0, 0, -0.1], [0, 0, 0], 1)") == pytest.approx([0, 0.1, 0, 0, 0, 0])
    assert motion("m.handMotion([0.1, 0.2, 0], [0, 0, 0], 1)") == pytest.approx([0.1, 0, 0.2, 0, 0, 0])
    # Ahead is -z, so a turn about +z is one about -away; a turn about y is one about up.
    assert motion("m.handMotion([0, 0, 0], [0.1, 0.2, 0.3], 1)") == pytest.approx([0, 0, 0, 0.1, -0.3, 0.2])
    assert motion("m.handMotion([1, 2, 3], [1, 2, 3], 0.5)") == pytest.approx([0.5, -1.5, 1, 1, -3, 2])


def test_products_of_quaternions_are_those_of_their_turns(motion):
    # A quarter turn about x takes y to z: after it, a quarter turn about z takes what was y nowhere.
    quarters = json.dumps([about("z", math.pi / 2), about("x", math.pi / 2)])
    assert motion(f"m.product(...{quarters})") == pytest.approx([0.5, 0.5, 0.5, 0.5])
    # The turn [.5, .5, .5, .5] is by 120 degrees about the diagonal.
    third = 2 * math.pi / 3 / math.sqrt(3)
    assert motion("m.rotationVector([0.5, 0.5, 0.5, 0.5])") == pytest.approx([third] * 3)
    assert motion("m.rotationVector([-0.5, -0.5, -0.5, -0.5])") == pytest.approx([third] * 3)
    assert motion(f"m.quaternion([{math.pi / 2}, 0, 0])") == pytest.approx([HALF, 0, 0, HALF])
    assert motion("m.rotationVector(m.quaternion([1e-12, 0, 0]))") == pytest.approx([1e-12, 0, 0], abs=1e-20)


def test_the_hand_moves_from_where_the_controller_was_grasped(motion):
    start, there = pose(0.3, 1.0, -0.5), pose(0.35, 1.02, -0.6)
    moves = followed(motion, start, there, there, None, pose(0.3, 1.0, -0.4), pose(0.3, 1.0, -0.41))
    assert moves[0] == [0] * 6, "grasping moves nothing"
    assert moves[1] == pytest.approx([0.05, 0.1, 0.02, 0, 0, 0])
    assert moves[2] == pytest.approx([0] * 6), "what is made is made once"
    assert moves[4] == [0] * 6, "letting go and grasping elsewhere moves nothing"
    assert moves[5] == pytest.approx([0, 0.01, 0, 0, 0, 0])


def test_the_hand_turns_as_the_controller_does_whatever_way_that_was_held(motion):
    held = about("y", 1.0)  # the grip points somewhere
    # A turn by 0.2 rad about the floor's z, on top of how it is held: [0, 0, s, c] * [0, s', 0, c'] by hand.
    s, c, s1, c1 = math.sin(0.1), math.cos(0.1), math.sin(0.5), math.cos(0.5)
    turned = (-s * s1, c * s1, s * c1, c * c1)
    moves = followed(motion, pose(0, 1, 0, turn=held), pose(0, 1, 0, turn=turned))
    assert moves[1] == pytest.approx([0, 0, 0, 0, -0.2, 0])


def test_what_is_too_fast_for_the_hand_is_made_up_for_while_it_is_held(motion):
    start, there = pose(0, 1, 0, turn=about("y", 0)), pose(0, 1, -0.12, turn=about("y", 0.5))
    moves = followed(motion, start, there, there, there, metres=0.05, radians=0.2)
    assert [move[1] for move in moves] == pytest.approx([0, 0.05, 0.05, 0.02])
    assert [move[5] for move in moves] == pytest.approx([0, 0.2, 0.2, 0.1])
    moves = followed(motion, start, there, None, there, there, metres=0.05, radians=0.2)
    assert moves[3] == moves[4] == [0] * 6, "letting go resets it"
    # The bound is on the hand's way, also where the hand moves three times as far as the controller.
    moves = followed(motion, start, pose(0, 1, -0.03), pose(0, 1, -0.03), metres=0.05, scale=3.0)
    assert [move[1] for move in moves] == pytest.approx([0, 0.05, 0.04])


def test_a_pose_that_jumps_moves_nothing(motion):
    start = pose(0, 1, 0)
    for jumped in (pose(0, 1.25, 0), pose(0, 1, 0, turn=about("x", 1.2))):
        moves = followed(motion, start, jumped, {**jumped, "position": [0, jumped["position"][1], -0.01]})
        assert moves[1] == [0] * 6
        assert moves[2] == pytest.approx([0, 0.01, 0, 0, 0, 0])


def test_the_right_controller_steers_or_the_only_one(motion):
    def chosen(*sources):
        return motion(f"m.steering({json.dumps(sources)})?.handedness ?? null")

    right = {"handedness": "right", "gripSpace": {}, "gamepad": {}}
    left = {**right, "handedness": "left"}
    assert chosen(left, right) == "right" and chosen(left) == "left" and chosen() is None
    assert chosen({**right, "hand": {}}, left) == "left", "a tracked hand has no grip button"
    assert chosen({**right, "gripSpace": None}) is None, "a tap on a phone's screen is no controller"


def test_images_hang_beside_each_other_without_overlap(tmp_path):
    folder = node.page_folder(tmp_path)
    sizes = [{"width": 256, "height": 256}, {"width": 320, "height": 240}, {"width": 64, "height": 64}]
    boxes = node.evaluated(folder, "wall.js", f"m.layout({json.dumps(sizes)})")
    assert len(boxes) == 4
    assert boxes[0] == pytest.approx([0, 1.35, 1.3, 1.3])
    assert boxes[1][2] / boxes[1][3] == pytest.approx(320 / 240)
    for number, (x, y, width, height) in enumerate(boxes):
        for u, v, across, along in boxes[:number]:
            assert abs(x - u) >= (width + across) / 2 - 1e-9 or abs(y - v) >= (height + along) / 2 - 1e-9
