"""Own scenes of primitives after four tasks of MimicGen (arXiv:2310.17596).

Start ranges D0 to D2 and rules of success are facts of that paper's environments; shapes are ours.
"""
