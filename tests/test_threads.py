import threading

from tactiled.threads import Turns
from tests.conftest import BUSY_S, until


def test_threads_have_their_turns_in_the_order_in_which_they_asked():
    turns, order = Turns(BUSY_S), []

    def work(name):
        with turns:
            order.append(name)

    threads = [threading.Thread(target=work, args=(n,)) for n in range(5)]
    with turns:
        for waiting, thread in enumerate(threads, 1):
            thread.start()
            until(lambda waiting=waiting: len(turns._waiting) == waiting)
        assert order == []
    for thread in threads:
        thread.join(BUSY_S)
    assert order == [0, 1, 2, 3, 4]


def test_a_slow_thread_is_overtaken_and_its_end_ends_no_other_turn():
    turns, slow_begun, slow_may_end, inside = Turns(0.01), threading.Event(), threading.Event(), []

    def slow():
        with turns:
            slow_begun.set()
            slow_may_end.wait(BUSY_S)

    def third():
        with turns:
            inside.append("third")

    thread, other = threading.Thread(target=slow), threading.Thread(target=third)
    thread.start()
    assert slow_begun.wait(BUSY_S)
    with turns:  # while the slow one has not ended
        turns._longest_s = BUSY_S
        other.start()
        until(lambda: turns._waiting)
        slow_may_end.set()
        thread.join(BUSY_S)
        assert inside == []
    other.join(BUSY_S)
    assert inside == ["third"]
    with turns:
        pass
