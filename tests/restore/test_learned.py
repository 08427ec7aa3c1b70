"""The learned network: what it is trained for, what it owes to the frame, and where it is not used."""

import numpy as np
import pytest

from tactiled.bench.skin import nrmse, rubber
from tactiled.cover.kernel import cached
from tactiled.geometry import raster
from tactiled.restore import learned
from tactiled.restore.methods import make
from tactiled.restore.scene import Scene
from tactiled.restore.wiener import Wiener
from tactiled.surface import make as surface_blur
from tests.bench import border
from tests.bench.judge import own
from tests.bench.presses import FAMILIES, presses
from tests.bench.train import Skin, arrays, network, samples
from tests.plans import plan


@pytest.fixture(scope="module")
def pressed():
    return list(presses(24, (1.0, 2.0), (0.01,), 2, seed=4, scenes=FAMILIES["second"]))


@pytest.mark.parametrize("number", [0, 6, 7, 13], ids=["grid", "ends with the taxels", "refined", "triangle"])
def test_it_is_the_network_that_was_trained(number, monkeypatch):
    """Made anew for one frame at a time, on buffers."""
    random, frames = np.random.default_rng(1), []
    skin = Skin(*arrays()[number], 1.25, number % 2, random)
    see = skin.inputs

    def seen(frame):
        frames.append(np.asarray(frame, np.float32))
        return see(frame)

    monkeypatch.setattr(skin, "inputs", seen)
    monkeypatch.setattr(Scene, "keep_force", lambda *_: None)
    monkeypatch.setattr(learned, "LIMIT", np.inf)
    *inputs, _ = skin.samples(8, random)
    fixed = (np.repeat(each[None], 8, axis=0) for each in (skin.maps, *skin.bases))
    images, doubts = network(learned.weights()._asdict(), (*inputs, *fixed))
    wiener = Wiener(skin.scene)
    restorer = learned.Learned(skin.scene, wiener)
    for frame, image, doubt, noise in zip(frames, images[-1], doubts, inputs[3], strict=True):
        skin.scene.look(frame)
        assert restorer(wiener()) == 3
        np.testing.assert_allclose(restorer.image * noise, image, atol=1e-4)
        np.testing.assert_allclose(
            restorer.deviation() * noise, np.exp(np.minimum(doubt, learned.MAX_DOUBT)), rtol=1e-3
        )


def test_samples_are_the_same_for_the_same_seed_and_looked_up(tmp_path):
    def drawn(seed, cache):
        (path,) = samples(1, 4, seed, tmp_path / cache, 0)
        return dict(np.load(path))

    first, again, stored, other = drawn(5, ""), drawn(5, "again"), drawn(5, ""), drawn(6, "")
    for name, each in first.items():
        np.testing.assert_array_equal(each, again[name])
        np.testing.assert_array_equal(each, stored[name])
    assert not np.array_equal(first["truths"], other["truths"])


def test_on_fine_cells_a_smooth_press_over_a_corner_gets_no_spike():
    """The network alone gives it twice its peak: it saw no array with so many fine cells."""
    surface, stack = border.skin("16 x 16", 2.15, 1)
    array = border.taxels("16 x 16")
    fine = 100 * np.exp(-((surface.x + 7.5) ** 2 + (surface.y + 7.5) ** 2) / 12.5)
    (truth,) = border.means(raster(array, 2), surface.x + 7.5, surface.y + 7.5, [fine])
    frame = np.ravel(surface.sense(fine))[: array.size].reshape(array.shape).astype(np.float32)
    noise = 0.01 * frame.max()
    frame += np.random.default_rng(1).normal(0, noise, frame.shape).astype(np.float32)
    image = make("learned", surface_blur(cached(stack), array, 2), noise)(frame).image
    assert image.max() < 1.4 * truth.max()


@pytest.mark.parametrize(("noise", "bound"), [(0.01, 1.0), (0.05, 0.95)])
def test_it_is_nearer_to_the_truth_than_total_variation_on_scenes_that_it_never_saw(noise, bound):
    scenes = list(presses(24, (1.0, 2.0), (noise,), 2, seed=4, scenes=FAMILIES["second"]))
    errors = {name: [nrmse(own(name)(each), each.truth) for each in scenes] for name in ("learned", "tv")}
    assert np.mean(errors["learned"]) < bound * np.mean(errors["tv"])


def test_its_image_explains_the_frame(pressed):
    """Nearly down to the noise, though its last stage looks at the frame no more."""
    for press in pressed:
        image = make("learned", press.blur, press.sigma)(press.frame).image
        residual = press.blur.forward(image) - press.frame
        assert np.linalg.norm(residual) < 1.6 * press.sigma * np.sqrt(residual.size)


@pytest.mark.parametrize("factor", [1e-4, 37.0, 1e5])
def test_the_unit_of_pressure_does_not_matter(pressed, factor):
    press = pressed[0]
    image = make("learned", press.blur, press.sigma)(press.frame).image.copy()
    scaled = make("learned", press.blur, factor * press.sigma)(np.float32(factor) * press.frame).image / factor
    np.testing.assert_allclose(scaled, image, atol=1e-3 * image.max())


@pytest.mark.parametrize(
    ("blur", "expected"),
    [
        (lambda: rubber(1.0, 16).blur, True),
        (lambda: plan((9, 30), 1.0).blur, True),
        (lambda: rubber(0.08, 16).blur, False),
        (lambda: rubber(9.0, 16).blur, False),
        (lambda: plan((1, 16), 1.0).blur, False),
        (lambda: plan((4, 6), 1.0, refine=2).blur, True),
        (lambda: plan((6, 6), 1.0, layout=True).blur, True),
    ],
    ids=["as trained", "oblong", "too thin", "too thick", "a single row", "small and refined", "no grid"],
)
def test_it_is_used_where_it_was_trained_for(blur, expected):
    made = blur()
    frame = np.zeros(made.frame_shape, np.float32)
    frame.flat[frame.size // 2] = 100.0
    done = make("learned", made, 0.1)(frame)
    assert (done.method == "learned") == expected
    assert expected or "restored by nnls" in done.why


def test_faults_that_nothing_tells_of_harm_it_less_than_total_variation_and_its_deviation_knows(pressed):
    """Three in a hundred taxels read zero, or gains are 10 % off."""
    random, ratios, within = np.random.default_rng(1), [], []
    for press in pressed:
        for fault in (random.random(press.frame.shape) > 0.03, 1 + 0.1 * random.normal(size=press.frame.shape)):
            frame = (fault * press.frame).astype(np.float32)
            restorer = make("learned", press.blur, press.sigma)
            image, flat = restorer(frame).image, make("tv", press.blur, press.sigma)(frame).image
            ratios.append(nrmse(image, press.truth) / nrmse(flat, press.truth))
            there = press.truth > 0.02 * press.truth.max()
            within.append(np.mean((abs(image - press.truth) < 2 * restorer.deviation())[there]))
    assert np.mean(ratios) < 0.9
    assert np.mean(within) > 0.9
