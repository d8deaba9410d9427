"""Teleoperation: a person at a browser steers the hand, and episodes are recorded as states.

:mod:`~roboverse_learn.teleoperation.session` is the state machine of one operator; it uses no network and no
clock. :mod:`~roboverse_learn.teleoperation.conductor` ticks sessions at the control rate and renders what is
watched, :mod:`~roboverse_learn.teleoperation.server` carries both to browsers.
"""
