"""robosuite's tasks of one Panda (arXiv:2009.12293, MIT): a family per file.

Sizes, ranges and success rules are those of ``robosuite/environments/manipulation`` 1.5.1. Its table top is
at z = 0.8 m, ours at 0; its objects fall a little at the start, ours begin at rest.
"""
