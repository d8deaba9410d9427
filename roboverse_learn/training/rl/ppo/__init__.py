"""PPO by three libraries: one configuration, one form of checkpoint, one loop around them."""
