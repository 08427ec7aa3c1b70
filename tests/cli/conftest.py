import pytest

from tests.cli.recordings import CONFIG, traffic, write


@pytest.fixture
def lossy(tmp_path):
    """A recording of which three messages are missing."""
    return write(tmp_path / "a.log", traffic(missing={(7, 0), (20, 1), (40, 1)}))


@pytest.fixture
def config(tmp_path):
    path = tmp_path / "a.toml"
    path.write_text('[server]\ncontrol_token = "0123456789abcdef"  # secret\n' + CONFIG)
    return path
