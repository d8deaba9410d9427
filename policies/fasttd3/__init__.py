"""FastTD3: TD3 with many environments, large batches and a distributional critic."""
