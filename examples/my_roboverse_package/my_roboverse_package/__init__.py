"""A task and a robot of one's own for RoboVerse Learn."""
