"""TD-MPC2: planning in the latent space of a learned world model."""
