"""A task, a robot and a policy of one's own for RoboVerse Learn."""
