"""Momentum, angular momentum and kinetic energy in scenes without gravity, on any simulator.

After the supplement of RoboVerse (arXiv:2504.18904), which compares simulators by these three quantities.
"""
