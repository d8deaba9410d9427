"""The Hugging Face hub: names of repositories, datasets from there, and pages of what is published."""
