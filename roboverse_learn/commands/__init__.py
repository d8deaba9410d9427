"""What the commands share: the run folder, the checkpoint under test, reports."""
