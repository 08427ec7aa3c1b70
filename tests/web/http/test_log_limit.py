import logging

from tactiled.web.http.log_limit import MAX_A_MINUTE, LogLimit


def test_of_each_kind_a_few_a_minute_are_logged_and_the_others_counted(caplog):
    now = 0.0
    log = logging.getLogger("tactiled.test_log_limit")
    log.addFilter(LogLimit(lambda: now))
    for n in range(MAX_A_MINUTE + 7):
        log.error(f"client 127.0.0.1:{n} is %s", "odd")
    log.error("another kind")
    assert [each.message for each in caplog.records][-2:] == [
        f"client 127.0.0.1:{MAX_A_MINUTE - 1} is odd",
        "another kind",
    ]
    assert len(caplog.records) == MAX_A_MINUTE + 1
    now = 60.0
    log.error("client 127.0.0.1:99 is %s", "odd")
    assert caplog.records[-1].message == "client 127.0.0.1:99 is odd (7 like it were left out before)"
