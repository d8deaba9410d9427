"""Demonstrations of one robot for another: the hand's commanded path, followed by another arm in physics."""
