"""Reinforcement learning: agents that learn from the environment they act in."""
