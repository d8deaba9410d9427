"""Action Chunking Transformer."""
