"""Grasping by language: one of several groceries, which the instruction names (the extra ``libero``).

The three sets are those of RoboVerse's table of language grasping (arXiv:2504.18904): few objects, many
objects, objects that no other set has. Three more teach colours: with them a policy can learn what "green"
and "ketchup" mean from two objects, and be asked for a third.
"""
