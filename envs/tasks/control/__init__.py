"""Tasks of continuous control that the paper compares with Isaac Lab: cartpole, ant, Franka reach."""
