"""`vapor-track benchmark step`: the network and the filter are timed, each without the other."""

from vapor.track import main


def test_the_network_of_a_preset_is_timed_without_a_model_and_without_the_filter(capsys):
    assert main(["benchmark", "step", "--preset", "demo", "--repetitions", "1", "--num-samples", "10"]) == 0
    out = capsys.readouterr().out
    assert "network, 10 samples" in out
    assert "filter" not in out


def test_the_filter_is_timed_as_it_ships_and_with_beliefs_that_have_as_many_hypotheses_as_asked_for(tiny_model, capsys):
    words = ["benchmark", "step", "--model", str(tiny_model), "--repetitions", "1", "--num-samples", "10"]
    assert main([*words, "--hypotheses", "7", "20"]) == 0
    out = capsys.readouterr().out
    assert "filter as it ships, 10 samples, " in out
    assert "filter, none merged, 7 hypotheses" in out
    assert "filter, none merged, 20 hypotheses" in out
