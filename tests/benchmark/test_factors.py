"""What was drawn for episodes, against whether they succeeded."""

from dataclasses import replace

import pytest
from PIL import Image

from benchmark.factors import Drawn, FactorSettings, compared, factors_of, main
from benchmark.protocol import Protocol
from benchmark.results import write_result
from envs.spec import EnvSpec


def drawn(values, successes, split="test", **more):
    return [
        Drawn(split=split, success=success, numbers={"size": float(value), "same": 1.0} | more)
        for value, success in zip(values, successes, strict=True)
    ]


def test_the_lowest_third_of_a_number_is_compared_with_the_highest():
    (factor,) = compared(drawn(range(9), [1, 1, 1, 0, 1, 0, 0, 0, 0]))
    assert factor.name == "size" and factor.low == (1.0, 3) and factor.high == (0.0, 3)
    assert factor.means == (1.0, 7.0)
    # Six episodes of mean 1/2 have the variance 6 / 4 / 5 = 0.3, the difference 0.3 * 2 / 3 = 0.2, and z is
    # 1 / sqrt(0.2) = 2.2361.
    assert factor.p_value == pytest.approx(0.0253473, abs=1e-6)


def test_two_factors_double_the_p_value_and_the_clearer_is_first():
    episodes = drawn(range(9), [1, 1, 1, 0, 1, 0, 0, 0, 0])
    noisy = [replace(each, numbers=each.numbers | {"a": float(i % 2)}) for i, each in enumerate(episodes)]
    first, second = compared(noisy)
    assert (first.name, second.name) == ("size", "a")
    assert first.p_value == pytest.approx(2 * 0.0253473, abs=1e-6) and second.p_value > 0.5


def test_splits_that_differ_in_size_and_success_make_no_factor():
    easy, hard = drawn(range(100, 130), [1] * 30, "train"), drawn(range(30), [0] * 30)
    (factor,) = compared(easy + hard)
    assert factor.p_value == 1.0 and factor.low == factor.high == (0.5, 20)


def test_strata_are_weighed_as_by_cochran_mantel_and_haenszel():
    one, two = (
        drawn(range(9), [1, 1, 1, 0, 1, 0, 0, 0, 0]),
        drawn(range(9), [1, 1, 0, 0, 1, 0, 1, 0, 0], "train"),
    )
    (factor,) = compared(one + two)
    # Both have the weight 9 / 6: differences 1 and 1/3, variances 0.2 each: z = (4 / 3) / sqrt(0.4) = 2.1082.
    assert factor.p_value == pytest.approx(0.0350153, abs=1e-6)


@pytest.mark.parametrize(("values", "low", "high"), [([0] * 8 + [1], 8, 1), ([0] + [1] * 8, 1, 8)])
def test_a_number_that_is_mostly_one_value_is_compared_with_the_others(values, low, high):
    (factor,) = compared(drawn(values, [1, 0, 1, 0, 1, 0, 1, 0, 1]))
    assert (factor.low[1], factor.high[1]) == (low, high)


def test_a_number_that_not_all_episodes_have_is_no_factor():
    assert not compared([*drawn([1], [1], a=1.0), *drawn([1], [0])])


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
    assert factors[0].low[0] == 1.0 and factors[0].high[0] == 0.0
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
    assert shown[1].startswith("environment.table brightness") and "100 % of " in shown[1]
    assert len(shown) == 5 and shown[-1].endswith("factors stand out (p < 0.05 after Bonferroni).")


@pytest.mark.slow
def test_what_has_no_factors_is_one_sentence(path, result, make_result, tmp_path, capsys):
    other, own, images = tmp_path / "other.json", tmp_path / "own.json", tmp_path / "images"
    images.mkdir()
    Image.new("RGB", (8, 8)).save(images / "one.png")
    write_result(other, make_result(task="StackCube"))
    write_result(own, replace(result, env=result.env.replace(materials="+images-1a2b3c4d")))
    for words, said in (
        ([], "Name the results: results="),
        ([f"results=[{path},{other}]"], "Results of several tasks, scenes or protocols share no factors"),
        (
            [f"results={path}"],
            "0 episodes are of level=3 splits=[train,test], and 30 are needed. There are 40 of level 1",
        ),
        (
            [f"results={own}", "level=1"],
            "drawn from the materials '+images-1a2b3c4d', given materials=none. Give the same.",
        ),
        (
            [f"results={path}", "level=1", f"materials={images}"],
            f"drawn from the built-in materials, given materials={images}. Give the same.",
        ),
    ):
        assert main(words) == 2
        assert said in capsys.readouterr().err
