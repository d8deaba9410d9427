"""A multi-task policy that reads the instruction, after BAKU (arXiv:2406.07539)."""
