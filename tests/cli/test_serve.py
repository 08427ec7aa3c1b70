from tactiled.interop.zenoh.signatures import robot_key
from tests.cli.commands import refusal, succeed
from tests.interop.zenoh_kit import KEY

TABLE = '[zenoh]\nlisten = ["tcp/127.0.0.1:7447"]\n'


def test_a_robots_line_is_printed_with_its_own_key_or_what_is_missing(tmp_path):
    config = tmp_path / "server.toml"
    config.write_text(f'{TABLE}control_key = "{KEY}"\n')
    assert succeed("serve", config, "--key", "left-hand") == f'control_key = "{robot_key(KEY, "left-hand")}"\n'
    assert refusal("serve", config, "--key", "left hand").startswith("--key left hand: no name of a robot")
    config.write_text(TABLE)
    assert refusal("serve", config, "--key", "left-hand").startswith(f"{config}: zenoh.control_key: missing")
