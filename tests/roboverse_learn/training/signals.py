"""A run that gets a signal while it trains."""

import signal

from roboverse_learn.training.reporter import Reporter


class SignalAt(Reporter):
    """Sends this process a signal at a step, as Ctrl-C or a scheduler of jobs does."""

    def __init__(self, step, number=signal.SIGTERM):
        self.step, self.number, self.checkpoints = step, number, []

    def on_step(self, progress):
        if progress.step == self.step:
            signal.raise_signal(self.number)

    def on_checkpoint(self, step, directory):
        self.checkpoints.append(step)
