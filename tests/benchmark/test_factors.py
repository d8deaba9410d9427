"""What was drawn for episodes, against whether they succeeded."""

from dataclasses import replace

import pytest

from benchmark.factors import FactorSettings, compared, factors_of, main
from benchmark.protocol import Protocol
from benchmark.results import write_result
from envs.spec import EnvSpec


def test_the_lowest_third_of_a_number_is_compared_with_the_highest():
    rows = [{"size": float(i), "same": 1.0, "noise": float(i % 2)} for i in range(9)]
    first, second = compared(rows, [True] * 3 + [False, True, False] + [False] * 3)
    assert (first.name, first.low, first.high) == ("size", (3, 3), (0, 3))
    # Of the C(6, 3) = 20 tables with these margins two are as extreme: 2 / 20, times two factors.
    assert first.p_value == pytest.approx(0.2)
    assert first.bounds == pytest.approx((8 / 3, 16 / 3))
    assert second.name == "noise" and second.p_value == 1.0


def test_a_number_that_not_all_episodes_have_is_no_factor():
    assert not compared([{"a": 1.0}, {"b": 2.0}], [True, False])


@pytest.fixture
def result(make_result):
    """A result of PickCube whose episodes succeed where the table is dark."""
    protocol = Protocol(levels=(1,), splits=("train",), episodes=40)
    made = make_result(protocol=protocol, task="PickCube")
    env = EnvSpec(task="PickCube", level=1).make(1, observation="state")
    episodes = protocol.episodes_of(env.split_indices)
    library, records = env.randomizer.library, []
    for record, episode in zip(made.records, episodes, strict=True):
        table = env.randomizer.draws(episode)["environment"]["textures"]["table"]
        dark = library.texture(table, 128).mean() < 120
        records.append(replace(record, episode=int(episode), success=bool(dark), length=9 if dark else 250))
    env.close()
    return replace(made, records=tuple(records))


@pytest.fixture
def path(result, tmp_path):
    path = tmp_path / "result.json"
    write_result(path, result)
    return path


@pytest.mark.slow
def test_what_decides_success_is_shown_first(path, caplog):
    settings = FactorSettings(results=(path,), level=1)
    factors = factors_of(settings)
    assert factors[0].name == "environment.table brightness" and factors[0].p_value < 0.001
    assert factors[0].low[0] == factors[0].low[1] and factors[0].high[0] == 0
    names = {factor.name for factor in factors}
    assert {
        "start.cube x_m",
        "start.cube yaw_rad",
        "environment.wall contrast",
        "environment.table_yaw_rad",
    } <= names
    with caplog.at_level("INFO"):
        assert main([f"results={path}", "level=1", "shown=3"]) == 0
    shown = "\n".join(record.getMessage() for record in caplog.records).splitlines()
    assert shown[0].split() == ["factor", "low", "success", "there", "high", "success", "there", "p"]
    assert shown[1].startswith("environment.table brightness") and "100 % [" in shown[1]
    assert len(shown) == 5 and shown[-1].endswith("factors stand out (p < 0.05 after Bonferroni).")


@pytest.mark.slow
def test_what_has_no_factors_is_one_sentence(path, result, make_result, tmp_path, capsys):
    other, own = tmp_path / "other.json", tmp_path / "own.json"
    write_result(other, make_result(task="StackCube"))
    write_result(own, replace(result, env=result.env.replace(materials="+images-1a2b3c4d")))
    for words, said in (
        ([], "Name the results: results="),
        ([f"results=[{path},{other}]"], "Results of several tasks or protocols share no factors"),
        (
            [f"results={path}"],
            "0 episodes are of level=3 splits=[train,test], and 30 are needed. The files have levels 1.",
        ),
        (
            [f"results={own}", "level=1"],
            "drawn from the materials '+images-1a2b3c4d'. Give materials=<folder>",
        ),
    ):
        assert main(words) == 2
        assert said in capsys.readouterr().err
