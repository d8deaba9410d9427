"""MuJoCo Warp: many worlds of one scenario on one GPU; also on CPU, slowly.

:mod:`device` is the only module that knows on what it runs. :mod:`settings` are what a scenario may
say about it, :mod:`worlds` the physics, :mod:`tracer` and :mod:`textures` the images, :mod:`handler`
all of it behind :class:`envs.simulators.base.Handler`.
"""
