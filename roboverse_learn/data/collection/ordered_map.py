"""Work on a stream of things in several threads, without changing their order."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor


def side_by_side[T, R](work: Callable[[T], R], things: Iterable[T], threads: int) -> Iterator[R]:
    """Yields ``work(thing)`` for every thing, in order, while later ones are being worked on.

    At most ``2 * threads`` are held, so that a fast source does not fill the memory. What was taken from
    ``things`` before it raised is finished and yielded first.

    Args:
        work: What is done; it should spend its time outside of the interpreter's lock.
        things: Taken one by one, by the caller's thread.
        threads: With 1, everything happens in the caller's thread.
    """
    if threads == 1:
        yield from map(work, things)
        return
    source, failure = iter(things), None
    pending: deque[Future[R]] = deque()
    with ThreadPoolExecutor(threads) as pool:
        while True:
            try:
                pending.append(pool.submit(work, next(source)))
            except StopIteration:
                break
            except Exception as error:
                failure = error
                break
            while len(pending) >= 2 * threads or (pending and pending[0].done()):
                yield pending.popleft().result()
        while pending:
            yield pending.popleft().result()
    if failure is not None:
        raise failure
