"""Skills that experts share: grasping, placing, moving a joint, from collision geometry and a state.

A skill returns waypoints of the hand; a task's expert chains skills and plans again where one failed.

Execution is batched over environments. Waypoints are planned one start at a time, because that is 14 % of an
expert's episode: 20 of 140 ms of CPU time in LIBERO's turn_on_the_stove (8 train episodes in MuJoCo, warm,
without rendering). Inverse kinematics along them takes another 16 ms.
"""
