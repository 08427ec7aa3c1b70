from tests.bench.contacts import measure


def test_the_restored_image_shows_position_force_and_number_of_contacts_better():
    raw, restored = measure(2.0, 0.01, 12)
    assert raw.single == 1
    assert restored.single > 0.9  # of 300 such discs one had a faint second contact beside it
    assert restored.off_mm < raw.off_mm < 0.03
    assert restored.off_95_mm < raw.off_95_mm
    assert restored.force < 0.02 < 0.05 < raw.force
    assert restored.gap_mm < raw.gap_mm
