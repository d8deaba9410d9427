from roboverse_learn.teleoperation.limits import ConnectionWatch, TokenBucket


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


def test_a_bucket_allows_a_burst_and_then_the_rate():
    clock = Clock()
    bucket = TokenBucket(10.0, 3, clock)
    assert [bucket.take() for _ in range(4)] == [True, True, True, False]
    clock.now = 0.1
    assert [bucket.take() for _ in range(2)] == [True, False]
    clock.now = 100.0
    assert sum(bucket.take() for _ in range(10)) == 3


class Connection:
    def __init__(self) -> None:
        self.transport, self.aborted = self, False

    def abort(self) -> None:
        self.aborted = True


def test_a_connection_that_says_nothing_is_closed_and_one_that_is_served_is_not():
    silent, served = Connection(), Connection()
    watch = ConnectionWatch(lambda: [silent, served], silence_s=5.0)
    with watch.serving(served):
        assert watch.sweep(0.0) == 0 and watch.sweep(4.9) == 0
        assert watch.sweep(5.0) == 1
    assert silent.aborted and not served.aborted
    watch.sweep(6.0)
    assert not served.aborted  # its own silence begins only after the answer


def test_the_newest_of_too_many_connections_are_closed():
    every = [Connection() for _ in range(5)]
    watch = ConnectionWatch(lambda: every, most=3)
    assert watch.sweep(0.0) == 2
    assert [each.aborted for each in every] == [False] * 3 + [True] * 2
