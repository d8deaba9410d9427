"""Genesis: all environments are one batch of a scene, loaded as MJCF tree by tree."""
