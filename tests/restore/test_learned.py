"""The learned network: what it is trained for, what it owes to the frame, and where it is not used."""

import numpy as np
import pytest

from tactiled.restore import learned
from tactiled.restore.methods import make
from tactiled.restore.scene import Scene
from tactiled.restore.wiener import Wiener
from tactiled.study.skin import nrmse, rubber
from tests.plans import plan
from tests.study.judge import own
from tests.study.presses import FAMILIES, PAPER, presses
from tests.study.train import Cover, batch, network, samples


@pytest.fixture(scope="module")
def pressed():
    return list(presses(24, (1.0, 2.0), (0.01,), 2, seed=4, scenes=FAMILIES["second"]))


@pytest.mark.parametrize("material", [{}, PAPER], ids=["rubber", "film"])
def test_it_is_the_network_that_was_trained(material, monkeypatch):
    """Made anew for one frame at a time, on buffers."""
    cover = Cover(1.25, material)
    random, frames, see = np.random.default_rng(1), [], cover.inputs

    def seen(frame):
        frames.append(np.asarray(frame, np.float32))
        return see(frame)

    monkeypatch.setattr(cover, "inputs", seen)
    monkeypatch.setattr(Scene, "keep_force", lambda *_: None)
    inputs, _ = batch([cover], samples([cover], 6, 3), random, 8)
    expected = network(learned.weights()._asdict(), inputs)[-1]
    scene = Scene(cover.skin.blur, 1.0)
    wiener = Wiener(scene)
    restorer = learned.Learned(scene, wiener)
    for frame, image, noise in zip(frames, expected, inputs[3], strict=True):
        scene.look(frame)
        assert restorer(wiener()) == 3
        np.testing.assert_allclose(restorer.image * noise, image, atol=1e-5)


def test_samples_are_the_same_for_the_same_seed_and_looked_up(tmp_path):
    cover = Cover(2.0, {})
    first, again, other = samples([cover], 3, 5, tmp_path), samples([cover], 3, 5), samples([cover], 3, 6)
    stored = samples([cover], 3, 5, tmp_path)
    for a, b, c in zip(first, again, stored, strict=True):
        np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(a, c)
    assert not np.array_equal(first[1], other[1])


def test_it_is_nearer_to_the_truth_than_total_variation_on_scenes_that_it_never_saw(pressed):
    methods = {name: own(name) for name in ("learned", "tv")}
    errors = {name: [nrmse(run(each), each.truth) for each in pressed] for name, run in methods.items()}
    assert np.mean(errors["learned"]) < 0.95 * np.mean(errors["tv"])


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
        (lambda: rubber(0.2, 16).blur, False),
        (lambda: rubber(6.0, 16).blur, False),
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


def test_the_image_of_dots_between_taxels_explains_the_frame_in_little_noise():
    """Its cells cannot follow them: what they miss is the image's error, no wrong model."""
    for press in presses(32, (0.7, 1.0, 1.5), (0.002,), 4, 41, ("braille",)):
        assert make("learned", press.blur, press.sigma)(press.frame).iterations == 3


def test_a_frame_that_the_model_does_not_explain_is_restored_warily(pressed):
    """Three in a hundred taxels read zero, and nothing says so."""
    ratios = []
    for n, press in enumerate(pressed):
        assert make("learned", press.blur, press.sigma)(press.frame).iterations == 3
        dead = np.random.default_rng(n).random(press.frame.shape) < 0.03
        frame = np.where(dead, 0, press.frame).astype(np.float32)
        done = make("learned", press.blur, press.sigma)(frame)
        if done.iterations > 3:
            flat = make("tv", press.blur, press.sigma)(frame).image
            ratios.append(nrmse(done.image, press.truth) / nrmse(flat, press.truth))
    assert len(ratios) > len(pressed) / 2
    assert np.mean(ratios) < 0.9
