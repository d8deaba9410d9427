"""Newton, the open successor of Isaac Gym: a scene built with its model builder, stepped by its solver."""
