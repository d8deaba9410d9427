"""Scripted experts: waypoints of the gripper, followed by inverse kinematics."""
