"""Meta-World's 50 tasks (Yu et al., CoRL 2019, arXiv:1910.10897), from the package ``metaworld`` 3.0.0."""
