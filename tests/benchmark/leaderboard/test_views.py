"""What views of the board say, from hand-made entries."""

import pytest

from benchmark.leaderboard.views import series_label


@pytest.mark.parametrize(
    ("steps", "time_s", "expected"),
    [
        (10_000, None, "ACT, preset gpu, 10,000 steps"),
        (None, 240.0, "ACT, preset gpu, 240 s"),
        (None, None, "ACT, preset gpu"),
    ],
)
def test_entries_of_one_name_are_told_apart_by_what_ended_their_training(steps, time_s, expected):
    entry = {"policy": "act", "label": "act", "kind": "preset", "name": "gpu", "variant": ""}
    entries = {
        "this": entry | {"steps": steps, "time_s": time_s},
        "other": entry | {"steps": 500, "time_s": None},
    }
    series = {"entry": "this", "label": "act", "transferred_from": ""}
    assert series_label(series, entries) == expected
    assert series_label(series, {"this": entries["this"]}) == "ACT, preset gpu"
