"""Forward and inverse kinematics of a robot arm, batched, and waypoint paths."""
