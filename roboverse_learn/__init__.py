"""Commands, configuration, data and training: everything that a user starts."""
