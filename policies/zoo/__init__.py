"""Every policy of LeRobot's registry, trained and evaluated by our commands: ``policy=lerobot type=<name>``."""
