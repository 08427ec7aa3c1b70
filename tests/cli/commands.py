"""The command line within the tests' process."""

import sys

from typer.testing import CliRunner

from tactiled.cli.app import app
from tactiled.errors import TactileError

TACTILED = (sys.executable, "-m", "tactiled")


def run(*arguments, **settings):
    return CliRunner().invoke(app, [str(each) for each in arguments], **settings)


def succeed(*arguments):
    """What a command prints; it ends well."""
    done = run(*arguments)
    assert done.exit_code == 0, (done.output, done.exception)
    return done.output


def refusal(*arguments):
    """The one line that a command refuses its input with."""
    done = run(*arguments)
    assert isinstance(done.exception, TactileError), (arguments, done.output)
    assert "\n" not in str(done.exception)
    return str(done.exception)
