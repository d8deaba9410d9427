"""Which collision shapes of PhysX touch which, as MuJoCo decides for their geoms.

PhysX keeps apart the shapes of one link, and those of a link and its parent. Beyond that, SAPIEN decides by
four words of each shape: type, affinity, ignore bits and id. Two shapes touch if a type bit of one is an
affinity bit of the other, as in MuJoCo, unless their ids are equal and they share an ignore bit.

So an ignore bit keeps all the shapes that have it apart from one another, and must not be given to two that
touch: the pairs to keep apart are covered by cliques, one bit each. Shapes that no chain of such pairs
connects have different ids, so that each set of connected shapes has 32 bits of its own.
"""

import logging
from collections.abc import Iterator

import mujoco
import numpy as np

from envs.mjcf.collision import touching
from envs.mjcf.link_tree import SceneSpec, TreeSpec

logger = logging.getLogger(__name__)

NUM_IGNORE_BITS = 32


def collision_groups(model: mujoco.MjModel, spec: SceneSpec) -> np.ndarray:
    """Returns the four words of each geom's shape, (ngeom, 4) uint32.

    A warning says how many pairs of bodies collide that should not, where the ignore bits do not suffice.

    Args:
        model: The compiled model.
        spec: What was read of it.
    """
    words = np.zeros((model.ngeom, 4), np.uint32)
    words[:, 0], words[:, 1] = model.geom_contype, model.geom_conaffinity
    words[~words.any(axis=1), :2] = 1  # a geom that touches only as half of a pair has no bits of its own
    geoms, linked = _shapes(spec)
    kind, with_kind = words[geoms, 0], words[geoms, 1]
    touch = touching(model, geoms)
    apart = ((kind[:, None] & with_kind) | (with_kind[:, None] & kind)).astype(bool) & ~linked & ~touch
    colliding: set[frozenset[int]] = set()
    for number, members in enumerate(_connected(apart), start=1):
        block = np.ix_(members, members)
        bits, left = _ignore_bits(apart[block], touch[block])
        words[geoms[members], 2], words[geoms[members], 3] = bits, number
        bodies = model.geom_bodyid[geoms[members]]
        colliding |= {frozenset(pair) for pair in bodies[np.argwhere(left)].tolist()}
    if colliding:
        first, second = (model.body(body).name for body in min(sorted(pair) for pair in colliding))
        logger.warning(
            "%d pairs of bodies collide in SAPIEN that the scene excludes from contact, such as '%s' and "
            "'%s': it has only %d sets of bodies that ignore each other. Take simulator=mujoco, or exclude "
            "fewer pairs.",
            *(len(colliding), first, second, NUM_IGNORE_BITS),
        )
    return words


def root_is_apart(tree: TreeSpec) -> bool:
    """Whether the shapes of a tree's root are a body of their own, which the links jointed to it touch."""
    return tree.touches_own_root and tree.root == "mocap" and len(tree.links) > 1


def _shapes(spec: SceneSpec) -> tuple[np.ndarray, np.ndarray]:
    """Returns the geoms that have shapes, (G,), and which of them PhysX itself keeps apart, (G, G) bool."""
    geoms = [geom for geom, _ in spec.still]
    links, parents, moves = [0] * len(geoms), [0] * len(geoms), [False] * len(geoms)
    first = 1
    for tree in spec.trees:
        for index, link in enumerate(tree.links):
            no_parent = link.parent < 0 or (link.parent == 0 and root_is_apart(tree))
            for geom, _ in link.geoms:
                geoms.append(geom)
                links.append(first + index)
                parents.append(first + index if no_parent else first + link.parent)
                moves.append(index > 0 or tree.root == "free")
        first += len(tree.links)
    link, parent, still = np.array(links), np.array(parents), ~np.array(moves, bool)
    jointed = (link[:, None] == parent) | (parent[:, None] == link)
    return np.array(geoms, np.intp), jointed | (link[:, None] == link) | (still[:, None] & still)


def _connected(apart: np.ndarray) -> Iterator[np.ndarray]:
    """Yields the indices of each set that a chain of pairs connects."""
    left = apart.any(axis=1)
    while left.any():
        members, grown = np.zeros_like(left), np.arange(len(apart)) == left.argmax()
        while not np.array_equal(members, grown):
            members, grown = grown, grown | apart[grown].any(axis=0)
        yield np.flatnonzero(members)
        left &= ~members


def _ignore_bits(apart: np.ndarray, touch: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Covers pairs by cliques, the largest that it finds first.

    Args:
        apart: Which pairs to keep apart, (G, G).
        touch: Which pairs have to touch, (G, G).

    Returns:
        The ignore bits of each shape, (G,), and which pairs are left, (G, G).
    """
    rows = np.concatenate([apart, touch], axis=1)  # shapes with equal rows, such as those of a body, are one
    _, some, of_shape = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    left, touch = apart[np.ix_(some, some)], touch[np.ix_(some, some)]
    bits = np.zeros(len(some), np.uint32)
    for bit in range(NUM_IGNORE_BITS):
        if not left.any():
            break
        clique = _clique(left, touch)
        bits[clique] |= np.uint32(1 << bit)
        left[np.ix_(clique, clique)] = False
    of_shape = of_shape.ravel()
    return bits[of_shape], left[np.ix_(of_shape, of_shape)]


def _clique(left: np.ndarray, touch: np.ndarray) -> list[int]:
    """Returns shapes that do not touch one another and among which many pairs are left; greedily."""
    clique = [int(left.sum(axis=1).argmax())]
    fits = ~touch[clique[0]]
    fits[clique] = False
    while True:
        gain = np.where(fits, left[clique].sum(axis=0), 0)
        if not gain.any():
            return clique
        later = left[:, fits].sum(axis=1)  # decides between equal gains
        best = int(np.where(gain, gain * (len(left) + 1) + later, 0).argmax())
        clique.append(best)
        fits &= ~touch[best]
        fits[best] = False
