import pytest

from tactiled.restore.auto import Auto
from tests.study.ablation import RULES, measure


def test_a_rule_that_is_off_is_one_that_auto_has():
    assert all(method in vars(Auto) for _, method, _ in RULES.values())


def test_rules_that_are_off_change_images_and_errors():
    results = measure((0.1, 1.0), 12, (0.02,), 10, 1)
    assert set(results) == {"none", *RULES}
    assert all(results[rule].changed for rule in ("idle", "wiener", "points", "warm start"))
    assert results["points"].error > 1.02 * results["none"].error
    assert results["points"].worse > 1.1
    assert results["pause"].error == pytest.approx(results["none"].error, rel=0.02)
