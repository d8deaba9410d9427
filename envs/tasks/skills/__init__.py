"""Skills that experts share: grasping, placing, moving a joint, from collision geometry and a state.

A skill returns waypoints of the hand; a task's expert chains skills and plans again where one failed.

Execution is batched over environments, and so is inverse kinematics, which takes most of a plan's time: see
:mod:`envs.kinematics.inverse`. Waypoints are made one start at a time: 0.1 to 0.3 ms in most tasks, and where
grasps are found on collision geometry, their candidates of one start are scored as arrays.
"""
