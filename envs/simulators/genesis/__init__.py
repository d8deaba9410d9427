"""Genesis: all environments are one batch of a scene that its loader of MJCF is told, tree by tree."""
