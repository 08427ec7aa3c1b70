"""The commented configurations of the package: what `tactiled init` writes, and two for `tactiled demo`."""

from pathlib import Path

_FOLDER = Path(__file__).parent / "examples"
EXAMPLE, SHEAR, GRASP = ((_FOLDER / f"{name}.toml").read_text("utf-8") for name in ("palm", "shear", "grasp"))
