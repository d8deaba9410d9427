"""Adapters of the Torch environment for Stable-Baselines3, rsl_rl and TorchRL.

Each adapter translates and computes nothing. All of them take a :class:`~envs.torch_env.TorchEnv`.
"""
