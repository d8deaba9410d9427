"""Every policy of LeRobot's registry, by our commands: ``policy=lerobot type=<name>``."""
