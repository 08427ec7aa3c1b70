import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.special import j0, j1

from tactiled.cover import elements, fem, layered, line
from tactiled.cover.stack import Layer, Profile, Stack

RUBBER = Layer(2.0, 0.5, 0.4999)
BOARD = Layer(1.6, 20_000.0, 0.3)
FOAM = Layer(3.0, 0.05, 0.1)
FOIL = Layer(0.05, 4_000.0, 0.35)
STIFF = Layer(0.5, 8_400.0, 0.4996), Layer(0.7, 4_200.0, 0.4988), Layer(2.2, 57.0, 0.3), Layer(6.2, 2.6, 0.4999)


def error(stack, solved):
    """Worst error of the elements' gain, between the samples too, wherever the exact gain is 1e-3 or more."""
    q = np.geomspace(solved.q[1] / 30, solved.q[-1], 600)
    exact = layered.gain(stack, q)
    return np.abs(fem.interpolant(solved.q, solved.gain)(q) - exact)[np.abs(exact) >= 1e-3].max()


@pytest.mark.parametrize(
    "stack",
    [
        *(Stack((Layer(thickness, 98.0, 0.3), Layer(1.0, 980.0, 0.3))) for thickness in (0.1, 0.2, 0.4, 0.6)),
        Stack((RUBBER, BOARD)),
        Stack((FOIL, FOAM, BOARD), sensing=2),
        Stack((FOIL, RUBBER, FOAM, BOARD), sensing=3),
        Stack((RUBBER,)),
        Stack((FOIL, Layer(10.0, 0.05, 0.4999), Layer(10.0, 200_000.0, 0.0)), sensing=2),
        Stack((RUBBER, BOARD), bonds=(False, True)),
        Stack((FOIL, RUBBER, BOARD), sensing=2, bonds=(True, False, False)),
        Stack((RUBBER, FOAM), sensing=2, bonds=(False, False)),
        *(Stack(STIFF, sensing) for sensing in (1, 2, 3)),
    ],
    ids=str,
)
def test_stacks_agree_with_the_exact_solution(stack):
    solved = fem.solve(stack, 1e-3)
    assert error(stack, solved) <= min(1e-3, 2 * solved.error_estimate)
    assert solved.unknowns < 60_000


@pytest.mark.parametrize("accuracy", [1e-2, 1e-4])
def test_another_accuracy_is_met(paper, accuracy):
    stack = paper(poisson=0.49)
    solved = fem.solve(stack, accuracy)
    assert error(stack, solved) <= min(accuracy, 2 * solved.error_estimate)
    assert solved.error_estimate <= accuracy


@pytest.mark.parametrize("poisson", [0.3, 0.49, 0.4999])
def test_gain_converges_at_twice_the_degree(paper, poisson):
    stack, growths = paper(poisson=poisson), np.array([0.5, 0.25, 0.125])
    q = fem._frequencies(12.0, 7.0)
    exact = layered.gain(stack, q)
    meshes = [fem._mesh(stack, None, 12.0, 0.1, growth, growth) for growth in growths]
    errors = [np.sqrt(np.mean((fem._gain(stack, mesh, 0.035, q) - exact) ** 2)) for mesh in meshes]
    assert np.polyfit(np.log(np.log1p(growths)), np.log(errors), 1)[0] > 5


@pytest.mark.parametrize(("rise", "thickness"), [(0.1, 0.3), (-0.1, 0.1), (0.0, 0.2)])
def test_a_wide_plateau_is_a_cover_of_its_own_thickness(paper, rise, thickness):
    solved = fem.solve(paper(), 1e-3, Profile((0.0, 3.0, 3.5), (rise, rise, 0.0)))
    q = np.array([1.0, 1.5, 2.0, 3.0, 4.0])
    np.testing.assert_allclose(
        fem.interpolant(solved.q, solved.gain)(q), layered.gain(paper(thickness), q), atol=1e-3
    )


def test_a_small_boss_lowers_and_a_small_dimple_raises_the_gain(paper):
    q = np.array([0.5, 1.0, 2.0])
    boss, flat, dimple = (
        fem.interpolant(solved.q, solved.gain)(q)
        for solved in (fem.solve(paper(), 1e-3, Profile((0.0, 0.3, 0.5), (h, h, 0.0))) for h in (0.05, 0.0, -0.05))
    )
    assert (boss < flat - 0.02).all()
    assert (dimple > flat + 0.02).all()


@pytest.mark.parametrize("radius", [0.02, 0.5, 3.0])
def test_a_footprint_of_any_radius_leaves_the_stress_that_the_exact_gain_gives(paper, radius):
    press, stack = fem.pressed(paper(), radius), paper()
    q = np.linspace(0, 60 / stack.depth, 400_001)
    waves = CubicSpline(q[::50], layered.gain(stack, q[::50]))(q) * 2 * np.pi * radius * j1(2 * np.pi * q * radius)
    exact = np.array([np.trapezoid(waves * j0(2 * np.pi * q * r), q) for r in press.r[::15]])
    assert np.abs(press.stress[::15] - exact).max() <= min(1e-3, 2 * press.error_estimate)


def test_a_boss_takes_stress_from_the_middle_of_a_footprint(paper):
    flat, boss = (
        fem.pressed(paper(), 0.3, profile=profile).stress[0]
        for profile in (None, Profile((0.0, 0.3, 0.4), (0.1, 0.1, 0.0)))
    )
    assert boss < flat - 0.02


@pytest.mark.parametrize(
    "stack", [Stack((RUBBER, BOARD)), Stack((Layer(2.0, 0.5, 0.3), FOAM), sensing=2)], ids=str
)
def test_tangential_loads_away_from_the_axis_agree_with_the_exact_solution(stack):
    """Such loads are sums of waves J1(kr) along their wave vector, as pressure is of J0(kr)."""
    reach, radius = 40.0, 1.0
    mesh = fem._mesh(stack, None, reach, 1.5, 0.15, 0.2)
    system = elements.assemble(stack, mesh)
    i, j = np.moveaxis(system.lattice, -1, 0)
    nodes = np.interp(np.arange(line.DEGREE * mesh.shape[0] + 1) / line.DEGREE, np.arange(len(mesh.r)), mesh.r)
    k = line.standing(np.arange(1, 25)) / reach
    bessel = j1(np.outer(k, nodes)), j0(np.outer(k, nodes))  # of what points outwards, and of what points down
    halves = system.dofs[:, : elements.SIZE], system.dofs[:, elements.SIZE :]
    above = system.row == mesh.starts[stack.sensing] - 1
    plane = j[above] == line.DEGREE * mesh.starts[stack.sensing]

    def gains(loaded):
        place = line.points(mesh.r)[0]
        force = line.forces(mesh.r, (place if loaded == 0 else 1) * np.exp(-((place / radius) ** 2)))
        load, dofs = np.zeros(system.size + 1), halves[loaded]
        load[dofs[j == 0]] = force[i[j == 0]]
        load[-1] = 0  # of what is fixed
        moved = np.append(elements.solve(system, load[:-1]), 0.0)
        stress = -(system.stiffness[above] @ moved[system.dofs[above]][:, :, None])[..., 0]
        felt = (np.bincount(i[above][plane], part[plane]) for part in np.split(stress, 2, axis=1))
        return [waves @ each / (bessel[loaded] @ force) for waves, each in zip(bessel, felt, strict=True)]

    (along, tilt), (apart, normal) = gains(0), gains(1)
    exact = layered.tangential(stack, k / (2 * np.pi))
    np.testing.assert_allclose(normal, layered.gain(stack, k / (2 * np.pi)), atol=2e-3)
    np.testing.assert_allclose([along, apart, tilt], exact[[0, 2, 3]], atol=2e-3)
