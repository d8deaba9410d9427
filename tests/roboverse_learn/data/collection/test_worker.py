import threading

from roboverse_learn.data.collection.worker import run_batches
from tests.roboverse_learn.data.collection.test_collect import config
from tests.roboverse_learn.data.synthetic_episodes import SyntheticSource


def test_a_batch_starts_while_the_last_episodes_of_the_one_before_are_staged(tmp_path):
    begun, second = [], threading.Event()

    class Source(SyntheticSource):
        def attempts(self, indices):
            begun.append(list(indices))
            if len(begun) == 2:
                second.set()
            return super().attempts(indices)

    def stage(directory, episode):
        assert second.wait(60), "The second batch waits for the first one's episodes."
        return directory

    ended = list(run_batches(config(tmp_path), Source(), [[1, 2], [3, 5]], threads=4, stage=stage))
    assert begun == [[1, 2], [3, 5]]
    assert [index for index, _ in ended] == [2, 1, 5, 3]


def test_the_simulation_goes_on_while_half_a_batch_is_staged(tmp_path):
    simulated = threading.Event()

    class Source(SyntheticSource):
        def attempts(self, indices):
            yield from super().attempts(indices)
            simulated.set()

    def stage(directory, episode):
        assert simulated.wait(60), "The batch waits for its own episodes."
        return directory

    batch = [1, 2, 3, 5, 6, 7]
    ended = list(run_batches(config(tmp_path, batch_size=12), Source(), [batch], threads=1, stage=stage))
    assert [index for index, _ in ended] == batch[::-1]


def test_episodes_that_wait_to_be_staged_are_left_where_a_collection_is_stopped(tmp_path):
    staged, stopped = [], threading.Event()

    def stage(directory, episode):
        if staged:
            assert stopped.wait(60)
        staged.append(directory)
        return directory

    batch = [1, 2, 3, 5, 6, 7]
    running = run_batches(config(tmp_path, batch_size=12), SyntheticSource(), [batch], threads=1, stage=stage)
    assert next(running)[0] == 7
    threading.Timer(0.2, stopped.set).start()
    running.close()
    assert len(staged) <= 2, "The one under way ends; the others were not begun."
