"""Skills that experts share: grasping, placing, moving a joint, from collision geometry and a state.

A skill returns waypoints of the hand; a task's expert chains skills and plans again where one failed.
"""
