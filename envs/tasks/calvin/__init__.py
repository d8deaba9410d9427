"""CALVIN: 34 tasks at four play tables, and chains of five instructions.

Mees et al., "CALVIN: A Benchmark for Language-Conditioned Policy Learning for Long-Horizon Robot
Manipulation Tasks", IEEE RA-L 2022, arXiv:2112.03227; ``mees/calvin_env`` at ``797142c`` and ``mees/calvin``
at ``fa03f01``, both MIT.
"""
