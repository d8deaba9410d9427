"""LIBERO's 130 tasks (Liu et al., arXiv 2306.03310): one folder, one data file, one class.

Scenes, starts and goals are read from the packages of the extra ``libero``; nothing of them is part of this
project. :mod:`~envs.tasks.libero.catalogue` names the tasks without reading any of it.
"""
