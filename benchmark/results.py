"""Results on disk: ``results/<protocol>/<task>/<policy>/<run>.json``, validated when read.

A file that was cut short, edited, or written by another version is refused with a message that says
what is wrong and what to do. It is never read in part.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, fields
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, NoReturn

from benchmark.instruction_scores import instruction_scores, wording_gaps
from benchmark.protocol import Protocol
from benchmark.record_columns import to_columns, to_rows
from benchmark.records import Checkpoint, EpisodeRecord, Git, Machine, Result
from benchmark.unregistered import check_registered
from envs.core.atomic import write_file
from envs.core.errors import ForeignFileError, ResultError, RoboVerseError
from envs.core.fingerprint import fingerprint
from envs.spec import EnvSpec

SCHEMA_VERSION = 3
_READABLE_VERSIONS = (1, 2, SCHEMA_VERSION)

_SHARED_ENV_KEYS = ("task", "simulator", "renderer")

_LOOSE_KEYS = (
    *("task", "task_kwargs", "simulator", "simulator_settings", "renderer"),
    *("cameras", "image_size", "scenario", "materials"),
)
"""Fields of the environment that a file of schema 1 has at its top level."""

_AGAIN = "Move the file away and evaluate the checkpoint again."
_ELSEWHERE = "Give the folder that roboverse evaluate writes to, or keep other JSON files out of it."

_HEAD = '{"schema_version":'
"""The beginning of every results file, without spaces."""

_OWN_KEYS = {"schema_version", "protocol", "protocol_hash", "cells", "records", "digest"}


def result_path(results_dir: Path, result: Result) -> Path:
    """Returns where a result belongs."""
    return results_dir / result.protocol.version / result.env.task / result.policy / f"{result.run}.json"


def video_dir(path: Path) -> Path:
    """Returns the folder of the videos that belong to a results file."""
    return path.with_suffix("")


def write_result(path: Path, result: Result) -> None:
    """Writes a result, atomically and only when reading it back would succeed.

    Raises:
        ResultError: The result does not follow the schema.
        WriteError: The file cannot be written.
    """
    document = _to_document(result)
    _check_schema(path, json.loads(json.dumps(document)))
    _from_document(path, document)
    lists = {"cells", "records"}
    parts = [
        f' "{key}": ' + (_one_per_line(value) if key in lists else json.dumps(value, allow_nan=False))
        for key, value in document.items()
    ]
    write_file(path, ("{\n" + ",\n".join(parts) + "\n}\n").encode())


def read_result(path: Path) -> Result:
    """Reads a results file and checks all of it.

    Raises:
        ResultError: The file is absent, cut short, of another schema, edited, or its cells do not
            follow from its records.
        UnregisteredError: It is whole, and of a channel or level that is not registered here.
        ForeignFileError: It is no results file at all.
    """
    text = ""
    try:
        text = path.read_bytes().decode()
        document = json.loads(
            text,
            parse_constant=_refuse_constant,
            parse_float=_finite_float,
            object_pairs_hook=_without_duplicates,
        )
    except OSError as error:
        raise ResultError(f"Could not read results file '{path}': {error.strerror or error}.") from error
    except (ValueError, RecursionError) as error:
        if not _begins_as_a_result(text):
            raise ForeignFileError(f"'{path}' is not a results file: {error}. {_ELSEWHERE}") from error
        raise ResultError(f"Results file '{path}' is not a whole JSON file: {error}. {_AGAIN}") from error
    _check_schema(path, document)
    return _from_document(path, document)


def _begins_as_a_result(text: str) -> bool:
    """Returns whether a text is, or was cut from, what :func:`write_result` writes."""
    head = "".join(text[:100].split())[: len(_HEAD)]
    return _HEAD.startswith(head)


def _one_per_line(values: list[Any]) -> str:
    return "[\n  " + ",\n  ".join(json.dumps(value, allow_nan=False) for value in values) + "\n ]"


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"it holds {name}, which is not a number")


def _finite_float(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text} is too large for a number")
    return value


def _without_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    values = dict(pairs)
    if len(values) != len(pairs):
        raise ValueError("a key appears twice in one object")
    return values


def _digest(document: Mapping[str, Any]) -> str:
    """Returns the SHA-256 of a document without its own digest."""
    rest = {key: value for key, value in document.items() if key != "digest"}
    return fingerprint(rest)


def _to_document(result: Result) -> dict[str, Any]:
    """Returns the file's content, in a readable order."""
    _check_shared(result)
    _check_train_tasks(result)
    values: dict[str, Any] = {item.name: getattr(result, item.name) for item in fields(Result)}
    values |= {
        "protocol": result.protocol.to_json(),
        "train_tasks": list(result.train_tasks),
        "env": result.env.to_json(),
        "checkpoint": asdict(result.checkpoint),
        "git": asdict(result.git) if result.git else None,
        "machine": asdict(result.machine),
    }
    if not result.train_tasks:
        del values["train_tasks"]
    if not result.recipe:
        del values["recipe"]
    records = values.pop("records")
    document = {"schema_version": SCHEMA_VERSION, **values, "protocol_hash": result.protocol.hash}
    document["cells"] = [summary.to_json() for summary in result.cells()]
    if result.protocol.instructions:
        document["instruction_scores"] = [score.to_json() for score in instruction_scores(records)]
        if gaps := wording_gaps(records):
            document["wording_gaps"] = [gap.to_json() for gap in gaps]
    document["records"], wordings = to_columns(records)
    if wordings:
        document["wordings"] = wordings
    try:
        return document | {"digest": _digest(document)}
    except (TypeError, ValueError) as error:
        raise ResultError(
            f"The result of run '{result.run}' holds a value that JSON cannot: {error}. The configuration "
            "must be resolved to numbers, strings, lists and dictionaries."
        ) from error


@cache
def _validator(version: int) -> Any:
    from jsonschema_rs import Draft202012Validator  # a hundredth of the time that jsonschema takes

    schema = json.loads(files("benchmark").joinpath(f"schema/result.v{version}.json").read_text())
    return Draft202012Validator(schema)


def _check_schema(path: Path, document: Any) -> None:
    own = _OWN_KEYS & document.keys() if isinstance(document, dict) else set()
    if len(own) < 2:
        raise ForeignFileError(
            f"'{path}' is not a results file: it has neither cells nor records. {_ELSEWHERE}"
        )
    if "schema_version" not in own:
        raise ResultError(f"'{path}' is not a results file: it has no schema_version. {_AGAIN}")
    version = document["schema_version"]
    if type(version) is not int or version not in _READABLE_VERSIONS:
        raise ResultError(
            f"Results file '{path}' has schema version {version!r}; this release reads "
            f"{', '.join(map(str, _READABLE_VERSIONS[:-1]))} and {SCHEMA_VERSION}. "
            f"{_AGAIN} Or install the release that wrote the file."
        )
    try:
        error = next(_validator(version).iter_errors(document), None)
    except ValueError as problem:  # half a surrogate pair is not text
        raise ResultError(f"Results file '{path}' holds invalid text: {problem}. {_AGAIN}") from problem
    if error is not None:
        where = "/".join(map(str, error.instance_path)) or "the top"
        message = error.message if len(error.message) < 300 else error.message[:300] + " …"
        raise ResultError(
            f"Results file '{path}' does not follow schema {version}: at {where}: {message}. {_AGAIN}"
        )


def _from_document(path: Path, document: dict[str, Any]) -> Result:
    """Builds the result of a document that follows the schema, and checks what a schema cannot."""
    is_whole = document["digest"] == _digest(document)
    if is_whole:  # in a file that was changed, a name may be the damage
        check_registered(path, document)
    try:
        protocol = Protocol.from_json(document["protocol"])
        if document["protocol_hash"] != protocol.hash:
            raise ResultError(
                f"its protocol hashes to {protocol.hash}, and it names {document['protocol_hash']}"
            )
        result = _build(_upgraded(document), protocol)
        _check_train_tasks(result)
        _check_cells(document["cells"], result)
        _check_scores(document.get("instruction_scores", []), result)
        if "wording_gaps" in document:  # files before it have the records alone
            _check_gaps(document["wording_gaps"], result)
    except RoboVerseError as error:
        raise ResultError(f"Results file '{path}': {error} {_AGAIN}") from error
    if not is_whole:
        raise ResultError(
            f"Results file '{path}' was changed after it was written: its digest does not match. {_AGAIN}"
        )
    return result


def _upgraded(document: dict[str, Any]) -> dict[str, Any]:
    """Returns a document of any readable schema with the keys of schema 2: a dictionary per record."""
    version = document["schema_version"]
    if version == SCHEMA_VERSION:
        return document | {"records": to_rows(document["records"], document.get("wordings", ()))}
    if version == 2:
        return document
    rest = {key: value for key, value in document.items() if key not in _LOOSE_KEYS}
    env = {key: document[key] for key in _LOOSE_KEYS if document.get(key) is not None}
    return rest | {"env": env, "sees_images": document["image_size"] is not None}


def _build(document: dict[str, Any], protocol: Protocol) -> Result:
    env = EnvSpec.from_json(document["env"])
    shared = {key: getattr(env, key) for key in _SHARED_ENV_KEYS}
    shared |= {"policy": document["policy"], "versions": document["versions"]}
    by_cell = {_cell_key(cell): cell for cell in document["cells"]}
    records = []
    for row in document["records"]:
        cell = by_cell.get(_cell_key(row))
        if cell is None:
            raise ResultError(f"episode {row['episode']} belongs to no cell of the file.")
        varied = {"channels": tuple(cell["channels"]), "not_shown": tuple(cell["not_shown"])}
        records.append(EpisodeRecord(**shared, **varied, **row, seed=protocol.seed))
    values = {item.name: document[item.name] for item in fields(Result) if item.name in document}
    values |= {
        "protocol": protocol,
        "train_tasks": tuple(document.get("train_tasks", ())),
        "env": env,
        "checkpoint": Checkpoint(**document["checkpoint"]),
        "git": Git(**document["git"]) if document["git"] else None,
        "machine": Machine(**document["machine"]),
        "records": tuple(records),
    }
    return Result(**values)


def _check_train_tasks(result: Result) -> None:
    """Checks that one task is named as learned only where another is tested."""
    if result.train_tasks == (result.env.task,):
        raise ResultError(
            f"it has train_tasks of {result.env.task} alone, which is the tested task. Leave them out."
        )


def _cell_key(values: Mapping[str, Any]) -> tuple[Any, ...]:
    return values["level"], values["only"], values["split"], values.get("instruction_test")


def _check_cells(cells: list[dict[str, Any]], result: Result) -> None:
    """Checks that the file's cells follow from its records."""
    summaries = result.cells()
    if len(cells) != len(summaries):
        raise ResultError(f"it has {len(cells)} cells, and its records make {len(summaries)}.")
    for cell, summary in zip(cells, summaries, strict=True):
        for key, value in summary.to_json().items():
            if not _agrees(cell[key], value):
                raise ResultError(f"{key} of {summary.cell} is {cell[key]}; its records give {value}.")


def _check_scores(scores: list[dict[str, Any]], result: Result) -> None:
    """Checks that the file's scores of instructions follow from its records."""
    own = [score.to_json() for score in instruction_scores(result.records)]
    _check_all(scores, own, "scores of instructions", "instruction test", "instruction_test")


def _check_gaps(gaps: list[dict[str, Any]], result: Result) -> None:
    """Checks that the file's gaps between wordings follow from its records."""
    own = [gap.to_json() for gap in wording_gaps(result.records)]
    _check_all(gaps, own, "gaps between wordings", "gap to the wording", "wording")


def _check_all(given: list[dict[str, Any]], own: list[dict[str, Any]], what: str, of: str, by: str) -> None:
    if len(given) != len(own):
        raise ResultError(f"it has {len(given)} {what}, and its records make {len(own)}.")
    for score, expected in zip(given, own, strict=True):
        for key, value in expected.items():
            if not _agrees(score[key], value):
                raise ResultError(
                    f"{key} of the {of} '{expected[by]}' is {score[key]}; its records give {value}."
                )


def _agrees(written: Any, value: Any) -> bool:
    """Returns whether a written value is the one of the records; another scipy may differ in the last bit."""
    close = isinstance(value, float) and math.isclose(written, value, abs_tol=1e-9)
    return close or bool(written == value)


def _check_shared(result: Result) -> None:
    """Checks that every record is of the run: shared values are written once per file."""
    shared = {key: getattr(result.env, key) for key in _SHARED_ENV_KEYS}
    shared |= {"policy": result.policy, "versions": result.versions}
    for record in result.records:
        for key, expected in shared.items():
            given = getattr(record, key)
            if given != expected:
                raise ResultError(
                    f"Episode {record.episode} of {record.cell} has {key} {given!r}, and the run "
                    f"'{result.run}' has {expected!r}. Write one result for each."
                )
        if record.seed != result.protocol.seed:
            raise ResultError(
                f"Episode {record.episode} of {record.cell} has seed {record.seed}; the protocol's is "
                f"{result.protocol.seed}."
            )
