"""Everything measured about restoration: speed, accuracy, limits, failures."""

from collections.abc import Callable
from dataclasses import dataclass, replace

from tactiled.study import ablation, alarms, discriminate, frontier, iterations, pairs, picard, stability
from tactiled.study.faults import Setting
from tactiled.study.pairs import Pair
from tactiled.study.skin import Skin, rubber
from tactiled.study.sweeps import Sweep, sweeps

Step = Callable[[str], None]
COVERS = (0.5, 1.0, 2.0, 3.0)
ITERATED = ("blobs", "punches")  # scenes that many iterations are made on
NOISE = 0.01  # of the peak, where one is enough


@dataclass(frozen=True, slots=True)
class Plan:
    """How much to measure, on which skins."""

    skins: tuple[Skin, ...]
    effort: frontier.Effort
    setting: Setting
    values: slice
    iterations: int
    trials: int
    places: int  # of sound frames
    frames: int  # of each of the ablation's films
    seed: int
    quick: bool

    @property
    def grids(self) -> list[Skin]:
        """The skins whose images a dip can be looked for in."""
        return [skin for skin in self.skins if skin.array.shape is not None]

    @property
    def steps(self) -> int:
        """How often `step` will be called."""
        return len(self.skins) * len(self.effort.noises) + len(sweeps(self.setting)) + 5 + len(self.grids)


@dataclass(frozen=True, slots=True)
class Findings:
    """All results."""

    panels: list[frontier.Panel]
    sweeps: list[tuple[Sweep, list[stability.Row]]]
    counts: list[iterations.Count]
    modes: list[picard.Picard]
    pairs: list[discriminate.Told]
    rules: list[ablation.Earned]
    together: list[Pair]
    alarms: alarms.Alarms


def plan(skins: tuple[Skin, ...], quick: bool, seed: int) -> Plan:
    """The default report, or the quick one; rubber covers where no skins are given."""
    effort = frontier.QUICK if quick else replace(frontier.Effort(), rounds=3)
    setting, values = stability.setting(quick, seed, skins[0] if skins else None)
    chosen = skins or tuple(rubber(t, effort.size) for t in (effort.covers if quick else COVERS))
    most, trials, places, frames = (300, 4, 4, 6) if quick else (10_000, 40, 120, 40)
    return Plan(chosen, effort, setting, values, most, trials, places, frames, seed, quick)


def measure(todo: Plan, step: Step) -> Findings:
    """Measure it all; `step` is told what was done, `todo.steps` times."""
    panels, sweeps, told = [], [], []
    for panel in frontier.panels(todo.skins, todo.effort, todo.seed):
        panels.append(panel)
        step(f"speed against accuracy: {panel.skin}, {100 * panel.noise:g} %")
    for found in stability.measure(todo.setting, todo.values):
        sweeps.append(found)
        step(f"stability: {found[0].name}")
    together = list(pairs.measure(todo.setting, todo.quick))
    step("stability: two at once")
    sound = alarms.measure(todo.skins, todo.effort.noises, todo.places, todo.seed)
    step("frames with nothing wrong")
    few = replace(todo.setting, skin=rubber(stability.COVER, 16 if todo.quick else 24), scenes=ITERATED)
    counts = iterations.measure(few, todo.iterations)
    step("iterations")
    modes = [picard.measure(skin, NOISE, todo.seed) for skin in todo.skins]
    step("what can be known")
    for skin in todo.grids:
        told.append(discriminate.measure(skin, NOISE, todo.trials, todo.seed))
        step(f"two points: {skin.name}")
    rules = ablation.measure([rubber(0.1, 16), *todo.skins], (0.01, 0.05), todo.frames, todo.seed)
    step("rules of auto")
    return Findings(panels, sweeps, counts, modes, told, rules, together, sound)
