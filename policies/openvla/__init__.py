"""OpenVLA (arXiv:2406.09246): a vision-language model whose words are actions."""
