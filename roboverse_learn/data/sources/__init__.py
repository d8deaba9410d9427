"""Demonstration sources: expert, policy, and files of other projects."""
