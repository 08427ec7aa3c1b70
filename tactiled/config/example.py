"""The commented configurations of the package: what `tactiled init` writes, and those of `tactiled demo`."""

from pathlib import Path

_FOLDER = Path(__file__).parent / "examples"
EXAMPLE, SHEAR, GRASP = ((_FOLDER / f"{name}.toml").read_text("utf-8") for name in ("palm", "shear", "grasp"))
# The demo's: a thicker cover, which blurs more, and the 3-axis skin beside it, with finer cells.
_SKIN = SHEAR[SHEAR.index("[sensor.skin]") :].replace(
    "[sensor.skin.codec]", "refine = 2\n\n[sensor.skin.codec]", 1
)
DEMO = EXAMPLE.replace("thickness_mm = 1.2", "thickness_mm = 2.0") + "\n" + _SKIN
