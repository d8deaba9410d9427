"""Octo (arXiv:2405.12213): a transformer reads patches and words, and a diffusion head its readout."""
