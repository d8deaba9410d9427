import json
import tempfile
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from benchmark.protocol import Protocol
from benchmark.records import Checkpoint, Git, Machine
from benchmark.results import read_result, result_path, write_result
from envs.core.errors import ResultError, WriteError
from envs.core.fingerprint import fingerprint

AGAIN = r"Move the file away and evaluate the checkpoint again\."
PROPERTY = settings(
    deadline=None,
    max_examples=40,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
JSON = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**53), 2**53)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


@pytest.fixture
def written(make_result, tmp_path):
    """A result on disk: its path and what it holds."""
    result = make_result(protocol=Protocol(episodes=3, levels=(0, 1)))
    path = result_path(tmp_path, result)
    write_result(path, result)
    return path, result


def edit(path, change):
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))


def test_a_result_has_its_place(written, tmp_path):
    assert written[0] == tmp_path / "v2" / "PickCube" / "act" / "act-s0.json"


def test_round_trip(written):
    path, result = written
    assert read_result(path) == result


def _as_schema_2(document):
    """Turns a document into what schema 2 was: a dictionary per record, with its words."""
    wordings, rows = document.pop("wordings", []), []
    for cell in document["records"]:
        for entry in range(len(cell["episode"])):
            row = {key: value[entry] if isinstance(value, list) else value for key, value in cell.items()}
            rows.append(
                row | {key: wordings[row[key]] for key in ("instruction", "switched_to") if key in row}
            )
    document |= {"records": rows, "schema_version": 2}
    _sign(document)


def _sign(document):
    document["digest"] = fingerprint({key: value for key, value in document.items() if key != "digest"})


def test_file_of_schema_2_reads_as_the_same_result(make_result, tmp_path):
    result = worded(make_result(protocol=INSTRUCTED))
    path = result_path(tmp_path, result)
    write_result(path, result)
    edit(path, _as_schema_2)
    assert read_result(path) == result
    edit(path, lambda document: document["records"][0].update(wall_time_s=1.0))
    with pytest.raises(ResultError, match="was changed after it was written"):
        read_result(path)


def test_file_of_schema_1_reads_as_the_same_result(make_result, tmp_path):
    changed = {
        "scenario": {"physics": {"decimation": 50}},
        "cameras": ("front", "wrist"),
        "task": "StackCube",
    }
    for result in (
        make_result(**changed, recipe=""),
        make_result(sees_images=False, image_size=256, recipe=""),
    ):
        path = result_path(tmp_path, result)
        write_result(path, result)
        edit(path, _as_schema_1)
        assert read_result(path) == result


def _as_schema_1(document):
    """Turns a document into what schema 1 was: loose fields, the empty ones left out."""
    _as_schema_2(document)
    env = document.pop("env")
    if not document.pop("sees_images"):
        env["image_size"] = None
    optional = ("simulator_settings", "scenario", "materials")
    document |= {key: value for key, value in env.items() if value or key not in optional}
    del document["level"], document["only"]
    document["schema_version"] = 1
    _sign(document)


def test_result_lists_tasks_learned_together(make_result, tmp_path, written):
    assert "train_tasks" not in json.loads(written[0].read_text())
    result = make_result(run="other", train_tasks=("PickCube", "humanoid/walk"))
    path = result_path(tmp_path, result)
    write_result(path, result)
    assert json.loads(path.read_text())["train_tasks"] == ["PickCube", "humanoid/walk"]
    assert read_result(path) == result
    with pytest.raises(ResultError, match="train_tasks"):
        write_result(path, replace(result, train_tasks=("PickCube",)))


def test_a_task_of_a_suite_in_a_family_has_its_place(publish, tmp_path):
    path = publish(task="libero/goal/turn_on_the_stove")
    assert path.parent == tmp_path / "v2" / "libero" / "goal" / "turn_on_the_stove" / "act"
    assert read_result(path).env.task == "libero/goal/turn_on_the_stove"


def test_the_records_of_a_cell_are_one_line_of_lists(written):
    path, result = written
    lines = path.read_text().splitlines()
    assert sum('"initial_state_hash"' in line for line in lines) == 4
    document = json.loads(path.read_text())
    assert document["cells"][0]["episodes"] == 3
    first = document["records"][0]
    assert (first["level"], first["only"], first["split"]) == (0, None, "train")
    for name in ("episode", "initial_state_hash", "success", "length", "episode_return", "wall_time_s"):
        assert first[name] == [getattr(record, name) for record in result.records[:3]]


@pytest.mark.slow
@PROPERTY
@given(
    config=st.dictionaries(st.text(), JSON, max_size=4),
    command=st.text(),
    rates=st.tuples(*[st.floats(0, 1)] * 4),
    levels=st.lists(st.integers(0, 3), unique=True, max_size=4).map(tuple),
    only=st.lists(st.sampled_from(["environment", "camera", "lighting"]), unique=True, min_size=1).map(tuple),
    episodes=st.integers(1, 6),
    seed=st.integers(0, 2**32),
    git=st.none()
    | st.builds(Git, sha=st.text("0123456789abcdef", min_size=40, max_size=40), dirty=st.booleans()),
    step=st.none() | st.integers(0, 2**40),
)
def test_every_result_reads_back_as_it_was_written(
    make_result, config, command, rates, levels, only, episodes, seed, git, step
):
    result = make_result(
        protocol=Protocol(levels=levels, only=only, episodes=episodes, seed=seed),
        rates=rates,
        config=config,
        command=command,
        git=git,
        checkpoint=Checkpoint(step=step),
        machine=Machine(device="cpu", cpu_count=1),
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.json"
        write_result(path, result)
        assert read_result(path) == result


@PROPERTY
@given(data=st.data())
def test_a_damaged_file_reads_as_it_was_or_not_at_all(written, data):
    path, result = written
    whole = path.read_bytes()
    start = data.draw(st.integers(0, len(whole)))
    length = data.draw(st.integers(0, 40))
    patch = data.draw(
        st.binary(max_size=8) | st.sampled_from([b"NaN", b"1e999", b"null", b"0", b'"', b"[" * 5000])
    )
    damaged = path.parent / "damaged.json"
    damaged.write_bytes(whole[:start] + patch + whole[start + length :])
    try:
        assert read_result(damaged) == result
    except ResultError as error:
        assert "damaged.json" in str(error)


@PROPERTY
@given(cut=st.floats(0, 0.999))
def test_a_truncated_file_is_an_error(written, cut):
    path, _ = written
    whole = path.read_bytes().rstrip()
    short = path.parent / "short.json"
    short.write_bytes(whole[: int(cut * len(whole))])
    with pytest.raises(ResultError, match=rf"short.json' is not a whole JSON file.*{AGAIN}"):
        read_result(short)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.update(schema_version=7), "has schema version 7; this release reads 1, 2 and 3"),
        (lambda d: d.pop("schema_version"), "is not a results file: it has no schema_version"),
        (lambda d: d.pop("records"), 'at the top: "records" is a required property'),
        *(  # a name ends up in a page
            (lambda d, key=key: d.update({key: "<script>"}), f'at {key}: "<script>" does not match')
            for key in ("run", "policy")
        ),
        (lambda d: d["env"].update(task="<script>"), 'at env/task: "<script>" does not match'),
        (lambda d: d.update(hostname="box"), "'hostname' was unexpected"),
        (lambda d: d["protocol"].update(episodes=0), "at protocol/episodes: 0 is less than the minimum of 1"),
        (
            lambda d: d["records"][0]["success"].__setitem__(1, "yes"),
            'at records/0/success/1: "yes" is not of type "boolean"',
        ),
        (lambda d: d["env"].update(task="../../etc"), 'at env/task: "../../etc" does not match'),
        (lambda d: d["env"].update(task="a//b"), 'at env/task: "a//b" does not match'),
        (lambda d: d["checkpoint"].update(choice="best"), 'at checkpoint/choice: "last" was expected'),
        (lambda d: d["protocol"].update(seed=1), "its protocol hashes to"),
        (
            lambda d: [each.pop() for each in d["records"][-1].values() if isinstance(each, list)],
            "Level 1, test split has 2 records of 2 episodes; the protocol needs 3",
        ),
        (
            lambda d: d["records"].pop(),
            "missing level 1, test split, unexpected none",
        ),
        (lambda d: d["records"][1]["success"].pop(), "the lists of records/1 have 2 and 3 values"),
        (
            lambda d: (
                d["records"][2].update(instruction=[0, 1, 0], episode=[0, 1, 2])
                or d.update(wordings=["lift"])
            ),
            "records/2 names wording 1, and the file has 1",
        ),
        (lambda d: d.update(schema_version=3.0), "has schema version 3.0; this release reads 1, 2 and 3"),
        (lambda d: d["cells"].pop(), "belongs to no cell of the file"),
        (lambda d: d["cells"].append(d["cells"][0]), "it has 5 cells, and its records make 4"),
        (
            lambda d: d["cells"][0].update(successes=0),
            "successes of level 0, train split is 0; its records give",
        ),
        (
            lambda d: d["cells"][0].update(ci_low=0.99),
            "ci_low of level 0, train split is 0.99; its records give",
        ),
        (
            lambda d: d["records"][0]["episode"].__setitem__(0, d["records"][0]["episode"][1]),
            "3 records of 2 episodes",
        ),
        (lambda d: d["records"][0]["wall_time_s"].__setitem__(0, 1.0), "was changed after it was written"),
        (lambda d: d.update(command="rm -rf /"), "was changed after it was written"),
    ],
)
def test_what_is_wrong_is_named(written, change, message):
    path, _ = written
    edit(path, change)
    with pytest.raises(ResultError) as caught:
        read_result(path)
    assert message in str(caught.value)
    assert str(path) in str(caught.value)


def test_half_a_surrogate_pair_is_no_text(written):
    path, _ = written
    edit(path, lambda d: d.update(task="\ud800"))
    with pytest.raises(ResultError, match=rf"holds invalid text.*{AGAIN}"):
        read_result(path)


@pytest.mark.parametrize("text", ["NaN", "Infinity", "1e999"])
def test_numbers_that_are_none_are_refused(written, text):
    path, result = written
    path.write_text(path.read_text().replace(repr(result.records[0].wall_time_s), text))
    with pytest.raises(ResultError, match="is not a whole JSON file"):
        read_result(path)


def test_an_absent_file_is_named(tmp_path):
    with pytest.raises(ResultError, match=r"Could not read results file '.*gone.json': No such file"):
        read_result(tmp_path / "gone.json")


def test_a_result_that_is_not_one_is_not_written(written):
    path, result = written
    before = path.read_bytes()
    lost = replace(result, records=result.records[:-1])
    with pytest.raises(ResultError, match="needs 3, each once"):
        write_result(path, lost)
    nan = replace(
        result, records=(replace(result.records[0], episode_return=float("nan")), *result.records[1:])
    )
    with pytest.raises(ResultError, match=r"has a return of nan .* Check the task's reward"):
        write_result(path, nan)
    with pytest.raises(ResultError, match="holds a value that JSON cannot"):
        write_result(path, replace(result, config={"optimizer": object()}))
    assert path.read_bytes() == before
    assert list(path.parent.iterdir()) == [path]


def test_records_must_be_of_the_run(written):
    path, result = written
    other = tuple(replace(record, policy="diffusion") for record in result.records)
    with pytest.raises(ResultError, match="has policy 'diffusion', and the run 'act-s0' has 'act'"):
        write_result(path, replace(result, records=other))
    other = tuple(replace(record, seed=9) for record in result.records)
    with pytest.raises(ResultError, match="has seed 9; the protocol's is 0"):
        write_result(path, replace(result, records=other))


def test_a_full_disk_leaves_the_old_file(written, monkeypatch):
    path, result = written
    before = path.read_bytes()

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(WriteError, match=r"the disk is full. What was complete before is unchanged"):
        write_result(path, replace(result, created="2027-01-01T00:00:00Z"))
    assert path.read_bytes() == before
    assert list(path.parent.iterdir()) == [path]


INSTRUCTED = Protocol(episodes=3, levels=(0, 1), instructions=("new_frame", "switched"))


def worded(result):
    """Returns a result whose records say what the policy was asked."""
    switched = {"switched_at": 7, "switched_to": "dance"}
    records = (
        replace(
            record, instruction="lift the cube", **(switched if record.instruction_test == "switched" else {})
        )
        for record in result.records
    )
    return replace(result, records=tuple(records))


def test_instruction_tests_and_their_scores_round_trip(make_result, tmp_path):
    result = worded(make_result(protocol=INSTRUCTED))
    path = result_path(tmp_path, result)
    write_result(path, result)
    assert read_result(path) == result
    document = json.loads(path.read_text())
    tests = [(score["instruction_test"], score["split"]) for score in document["instruction_scores"]]
    assert tests == [(test, split) for test in ("new_frame", "switched") for split in ("train", "test")]
    assert document["wordings"] == ["lift the cube", "dance"]
    assert document["records"][0]["instruction"] == [0, 0, 0]
    (switched,) = (
        each["switched_to"]
        for each in document["records"]
        if "switched_to" in each and each["split"] == "test"
    )
    assert switched == [1, 1, 1]
    assert "instruction_test" not in document["cells"][0] and "switched_at" not in document["records"][0]


def test_a_file_without_instructions_has_none_of_their_keys(written):
    document = json.loads(written[0].read_text())
    assert "instruction_scores" not in document and "instructions" not in document["protocol"]
    assert "wordings" not in document
    assert not any(key.startswith(("instruction", "switched")) for row in document["records"] for key in row)


def test_a_score_that_does_not_follow_from_the_records_is_refused(make_result, tmp_path):
    result = worded(make_result(protocol=INSTRUCTED))
    path = result_path(tmp_path, result)
    write_result(path, result)
    edit(path, lambda document: document["instruction_scores"][1].update(difference=0.9))
    with pytest.raises(ResultError, match=r"difference of the instruction test 'new_frame' is 0\.9"):
        read_result(path)
    edit(path, lambda document: document.pop("instruction_scores"))
    with pytest.raises(ResultError, match=r"it has 0 scores of instructions, and its records make 4"):
        read_result(path)


WORDINGS = Protocol(episodes=3, levels=(0,), splits=("test",), instructions=("known", "new_words"))


def test_gaps_between_wordings_are_written_and_checked_and_may_be_absent(make_result, tmp_path, monkeypatch):
    result = worded(make_result(protocol=WORDINGS))
    path = result_path(tmp_path, result)
    write_result(path, result)
    (gap,) = json.loads(path.read_text())["wording_gaps"]
    assert (gap["wording"], gap["split"], gap["episodes"]) == ("new_words", "test", 3)
    edit(path, lambda document: document["wording_gaps"][0].update(known_rate=0.12))
    with pytest.raises(ResultError, match=r"known_rate of the gap to the wording 'new_words' is 0\.12"):
        read_result(path)
    monkeypatch.setattr("benchmark.results.wording_gaps", lambda records: ())
    write_result(path, result)
    assert "wording_gaps" not in json.loads(path.read_text())
    monkeypatch.undo()
    assert read_result(path) == result, "a file from before there were gaps"
