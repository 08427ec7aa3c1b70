from tactiled.bench.results import host_meter


def test_the_time_that_a_host_takes_is_that_of_the_fields_in_proc(tmp_path):
    stat = tmp_path / "stat"
    stat.write_text("cpu  100 0 50 800 10 0 0 40 7 7\ncpu0 1 1 1 1 1 1 1 1\n")
    text = host_meter(stat)
    stat.write_text("cpu  150 0 60 820 10 0 0 60 9 9\n")  # 100 more, 20 of them stolen
    assert text() == "; its host took 20.0% of its processor time meanwhile"
    assert host_meter(tmp_path / "none")() == ""
