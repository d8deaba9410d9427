"""MuJoCo Warp: many worlds of one scenario on one GPU; also on CPU, slowly.

:mod:`device` alone depends on the device. :mod:`settings` has a scenario's settings, :mod:`worlds` the
physics, :mod:`tracer` and :mod:`textures` the images, and :mod:`handler` combines them into a
:class:`envs.simulators.base.Handler`.
"""
