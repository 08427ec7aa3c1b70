import pytest
from typer.testing import CliRunner

from tactiled.bench import bus
from tactiled.cli import bench_bus
from tactiled.cli.app import app

__all__ = ["bench_bus"]  # importing it gives the command line its verb


def test_every_message_that_is_sent_is_received_and_counted(request):
    told = bus.live({"interface": "virtual", "channel": request.node.name}, rate=20_000, seconds=0.1)
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


@pytest.mark.parametrize("rate", ["0", "-5"])
def test_a_rate_that_is_none_is_refused(rate):
    assert CliRunner().invoke(app, ["bench", "bus", "--rate", rate]).exit_code == 2
