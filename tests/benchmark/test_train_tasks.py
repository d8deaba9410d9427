"""The tasks that a result says were learned, where the one that was tested is none of them."""

import json

import pytest

from benchmark.results import read_result, result_path, write_result
from envs.core.errors import ResultError


def test_result_of_another_task_lists_the_one_that_was_learned(make_result, tmp_path):
    result = make_result(task="StackCube", train_tasks=("PickCube",))
    path = result_path(tmp_path, result)
    write_result(path, result)
    assert read_result(path).train_tasks == ("PickCube",)


def test_a_file_that_lists_the_tested_task_alone_is_refused(make_result, tmp_path):
    result = make_result(task="StackCube", train_tasks=("PickCube",))
    path = result_path(tmp_path, result)
    write_result(path, result)
    document = json.loads(path.read_text())
    path.write_text(json.dumps(document | {"train_tasks": ["StackCube"]}))
    with pytest.raises(ResultError, match="train_tasks of StackCube alone, which is the tested task"):
        read_result(path)
