import pytest

from tactiled.bus.pace import BACK_S, PAUSE_S, Pace


def played(times):
    pace = Pace()
    told = [pace.go(each) for each in times]
    return pace, told


def test_it_goes_as_the_messages_do():
    pace, told = played([1e9, 1e9 + 0.5, 1e9 + 0.5, 1e9 + PAUSE_S])
    assert (pace.now, pace.steps, told) == (PAUSE_S, 0, [None] * 4)


def test_messages_of_several_buses_that_are_out_of_order_change_nothing():
    pace, told = played([0.0, 5.0, 4.2, 5.1, 4.3, 6.0])
    assert (pace.now, told) == (6.0, [None] * 6)


@pytest.mark.parametrize(
    ("step", "goes_on", "says"),
    [
        (3600.0, PAUSE_S, "pauses for 3600 s before message 3"),
        (-3600.0, BACK_S, "steps back in time by 3600 s at message 3"),
        (4e9, PAUSE_S, "pauses for 4e+09 s before message 3"),
    ],
)
def test_a_step_is_told_and_hardly_played(step, goes_on, says):
    pace, told = played([4000.0, 4001.0, 4001.0 + step, 4002.0 + step])
    assert pace.now == pytest.approx(1.0 + goes_on + 1.0)
    assert (told, pace.steps) == ([None, None, says, None], 1)


def test_it_never_goes_back():
    pace, last = Pace(), 0.0
    for at in range(200):
        pace.go(((at * 7919) % 101) * 37.0)
        assert pace.now >= last
        last = pace.now
