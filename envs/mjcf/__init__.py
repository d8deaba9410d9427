"""From a scenario to a compiled ``mujoco.MjModel``, and the model as trees of links."""
