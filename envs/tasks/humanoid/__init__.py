"""HumanoidBench's locomotion tasks for the Unitree H1, as published."""
