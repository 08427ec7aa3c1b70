import logging
import os
import pty
import signal
import subprocess
from contextlib import suppress
from types import SimpleNamespace

import pytest

from tactiled.cli.top import Interval, Scrape
from tactiled.config import Server
from tactiled.errors import TactileError
from tactiled.web.server import running
from tests.cli.commands import TACTILED, refusal, succeed
from tests.conftest import pressed, until

AGES = "tactiled_frame_age_seconds"


def scrape(time, lost, below_1_ms, below_1_s, every, restored, cpu_s, name="palm"):
    """What a service answers at a time (s)."""
    age = f'{AGES}_bucket{{sensor="{name}",at="publish",le='
    lines = (
        f'tactiled_state{{sensor="{name}",state="live"}} 1.0',
        f'tactiled_state{{sensor="{name}",state="stale"}} 0.0',
        f'tactiled_rate_hertz{{sensor="{name}"}} 99.96',
        f'tactiled_loss_total{{sensor="{name}",kind="lost"}} {lost}',
        f'tactiled_loss_total{{sensor="{name}",kind="late"}} 0.0',
        f'{age}"0.001"}} {below_1_ms}', f'{age}"1.0"}} {below_1_s}', f'{age}"+Inf"}} {every}',
        f'tactiled_restore_seconds_count{{sensor="{name}",method="tv"}} {every}',
        f'tactiled_restore_seconds_sum{{sensor="{name}",method="tv"}} {restored}',
        f'tactiled_warning{{sensor="{name}",code="saturated"}} 1.0',
        "tactiled_streams 3.0", "tactiled_connections 5.0",
        f"process_cpu_seconds_total {cpu_s}", "process_resident_memory_bytes 1.5e8",
    )  # fmt: skip
    made = Scrape(SimpleNamespace(url="http://here", metrics=lambda: "\n".join(lines) + "\n"))
    made.time = time
    return made


def test_a_row_is_what_happened_between_two_scrapes():
    interval = Interval(scrape(10.0, 3, 10, 10, 10, 1.0, 5.0), scrape(14.0, 5, 60, 110, 110, 1.06, 7.0))
    assert [*interval.cells("palm")] == [
        "palm", "live", "100.0", "1.00 / 980.02", "–", "tv 0.60", "lost 5 (+2)", "saturated",
    ]  # fmt: skip
    assert interval.caption() == "0.50 cores, 150 MB, 3 streams, 5 connections"
    assert interval.quantile(0.25, AGES, sensor="palm", at="publish") == pytest.approx(0.0005)


def test_a_restarted_service_counts_anew_and_a_name_controls_no_terminal():
    interval = Interval(scrape(10.0, 9, 50, 50, 50, 1.0, 50.0), scrape(12.0, 4, 8, 8, 8, 0.004, 1.0))
    assert [*interval.cells("palm")][3:7] == ["0.50 / 0.99", "–", "tv 0.50", "lost 4 (+4)"]
    above_1_s = Interval(*(scrape(every, 0, 0, 0, every, 0, 0, "\x1b[2J") for every in (1, 2)))
    assert [*above_1_s.cells(r"\x1b[2J")][3] == "1000.00 / 1000.00"


def test_one_table_is_printed_plainly_with_the_token_of_the_environment(rig, monkeypatch, caplog):
    caplog.set_level(logging.ERROR, "tactiled.events")  # of the service in this process: no part of the table
    token = "control-" + "c" * 16
    rig.show(pressed())
    rig.send(pressed(), drop=(1,))
    until(lambda: rig.sensor.status().loss.lost)
    with running(rig.service, Server(port=0, control_token=token)) as url:
        assert "a token is needed" in refusal("top", url, "--once")
        monkeypatch.setenv("TACTILED_TOKEN", token)
        output = succeed("top", url, "--once", "--interval", "0.1")
    assert token not in output
    assert all(each.isprintable() for each in output.splitlines())
    title, head, row, caption = output.splitlines()
    assert [each.split()[0] for each in (title, head, row)] == [url, "sensor", "palm"]
    assert "lost 1" in row
    assert "0 streams" in caption


@pytest.mark.parametrize("text", ["<html>another</html>\n", "up 1\n"])
def test_what_is_no_service_is_named_and_a_server_may_have_no_sensor(text):
    Scrape(SimpleNamespace(url="http://here", metrics=lambda: "# TYPE tactiled_state gauge\n"))
    with pytest.raises(TactileError, match="http://here: no service of tactiled: "):
        Scrape(SimpleNamespace(url="http://here", metrics=lambda: text))
    assert refusal("top", "http://127.0.0.1:9", "--once").endswith("Connection refused: is the service running?")


def test_on_a_terminal_the_table_is_live_also_after_the_service_was_away_and_ctrl_c_ends_it(rig):
    rig.show(pressed())
    ours, its = pty.openpty()
    with running(rig.service) as url:
        command = [*TACTILED, "top", url, "--interval", "0.1"]
        process = subprocess.Popen(command, stdin=its, stdout=its, stderr=its, env=os.environ | {"TERM": "xterm"})
        os.close(its)
        output = b""
        while output.count(b"palm") < 2:
            output += os.read(ours, 4096)
    while b"is the service running?" not in output:
        output += os.read(ours, 4096)
    before = output.count(b"palm")
    with running(rig.service, Server(port=int(url.rpartition(":")[2]))):
        while output.count(b"palm") == before:
            output += os.read(ours, 4096)
        process.send_signal(signal.SIGINT)
        with suppress(OSError):  # the end of a terminal
            while data := os.read(ours, 4096):
                output += data
        assert process.wait() == 0
    os.close(ours)
    assert output.count(b"\x1b[?1049h") == output.count(b"\x1b[?1049l") == 1
    assert b"Traceback" not in output
