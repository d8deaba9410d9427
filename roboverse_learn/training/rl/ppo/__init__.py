"""PPO by three libraries: one configuration, one form of checkpoint, one loop around them."""

from roboverse_learn.training.rl.ppo.learner import learn

__all__ = ["learn"]
