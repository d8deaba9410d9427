"""MuJoCo: the physics, and the three renderers of its models."""
