"""ManiSkill 3's table-top tasks (arXiv:2410.00425, Apache-2.0), built from primitives: a family per file.

Sizes, ranges and success rules are those of ``mani_skill/envs/tasks/tabletop``. Its horizons are made for
end-effector deltas; ours are twice as long or more, for joint positions at the same 20 Hz.
"""
