"""Draw cover.svg: what rubber on a circuit board leaves of a detail, by the rubber's thickness."""

from pathlib import Path

import numpy as np

from tactiled.charts.style import COLOURS, MARKS, figure
from tactiled.cover.layered import gain
from tactiled.cover.stack import Layer, Stack

BOARD = Layer(thickness=1.6, young=20_000.0, poisson=0.3)

width = np.geomspace(0.1, 50, 300)  # mm
with figure(Path(__file__).with_suffix(".svg"), 6.6, 3.5) as drawn:
    axis = drawn.subplots()
    for number, thickness in enumerate((0.2, 0.5, 1.0, 2.0, 5.0)):
        left = gain(Stack((Layer(thickness, young=0.5, poisson=0.49), BOARD)), 1 / (2 * width))
        every = (8 * number + 10, 50)
        axis.semilogx(
            width,
            left,
            color=COLOURS[number],
            marker=MARKS[number],
            mfc="white",
            markevery=every,
            label=f"{thickness:g} mm",
        )
    axis.set(xlabel="width of the detail, half a wave (mm)", ylabel="gain: what is left of it", ylim=(0, 1.03))
    axis.set(xlim=(0.1, 50))
    axis.set_xticks((0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50), ("0.1", "0.2", "0.5", "1", "2", "5", "10", "20", "50"))
    axis.minorticks_off()
    axis.set_title("Silicone rubber on a circuit board")
    axis.legend(title="rubber", loc="lower right")
