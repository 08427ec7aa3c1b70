from tactiled.live import budget


def test_a_step_that_would_end_after_the_deadline_does_not_begin(monkeypatch):
    now = 5.0
    monkeypatch.setattr(budget, "thread_time", lambda: now)
    deadline, stops = budget.Deadline(1.0), []
    for step in (0.1, 0.3, 0.25, 0.1, 0.2):  # s; the time is 0.1, 0.4, 0.65, 0.75, 0.95 s
        now += step
        stops.append(deadline())
    assert stops == [False, False, False, False, True]
    now += 0.5
    assert deadline()
