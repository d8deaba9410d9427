"""A task, a robot, a policy and a randomization channel of one's own for RoboVerse Learn."""
