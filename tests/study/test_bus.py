import pytest
from typer.testing import CliRunner

from tactiled.cli import bench_bus
from tactiled.cli.app import app
from tactiled.study import bus

__all__ = ["bench_bus"]  # importing it gives the command line its verb


def test_every_message_that_is_sent_is_received_and_counted(request):
    told = bus.live([{"interface": "virtual", "channel": request.node.name}], rate=20_000, seconds=0.1)
    assert (told.sent, told.received, told.lost) == (2000, 2000, 0)
    assert told.rate > 0
    assert told.cores > 0


def test_every_codec_is_measured_both_ways():
    found = list(bus.offline(0.05))
    assert len(found) == 3
    for each in found:
        assert min(each.received, each.encoded) > 0


def test_the_figures_come_with_the_machine(request):
    result = CliRunner().invoke(
        app, ["bench", "bus", "--seconds", "0.05", "--rate", "2000", "--channel", request.node.name]
    )
    assert result.exit_code == 0, result.output
    assert "100 messages sent at 2,000/s, 100 received at" in result.output
    assert "Python 3." in result.output


def test_several_buses_are_read_at_once(request):
    buses = [{"interface": "virtual", "channel": f"{request.node.name}{n}"} for n in range(3)]
    told = bus.live(buses, rate=9_000, seconds=0.1)
    assert (told.sent, told.received, told.lost) == (900, 900, 0)
    assert told.label.count(request.node.name) == 3


def test_any_vcan_is_measured_too_unless_a_bus_is_named(monkeypatch, tmp_path):
    monkeypatch.setattr(bench_bus, "LINKS", tmp_path)
    (tmp_path / "vcan1").touch()
    virtual = [{"interface": "virtual", "channel": "tactiled-bench"}]
    assert bench_bus._buses(None, None) == [virtual, [{"interface": "socketcan", "channel": "vcan1"}]]
    assert bench_bus._buses("virtual", None) == [virtual]
    two = [{"interface": "socketcan", "channel": name} for name in ("can0", "can1")]
    assert bench_bus._buses("socketcan", ["can0", "can1"]) == [two]


def test_a_processor_time_told_in_coarse_steps_is_not_given(monkeypatch, request):
    monkeypatch.setattr(bus, "_tick", lambda: 0.01)
    assert bus.live([{"interface": "virtual", "channel": request.node.name}], rate=1000, seconds=0.1).cores is None


@pytest.mark.parametrize("rate", ["0", "-5"])
def test_a_rate_that_is_none_is_refused(rate):
    assert CliRunner().invoke(app, ["bench", "bus", "--rate", rate]).exit_code == 2
