"""Records as lists side by side, and back."""

from dataclasses import replace

from benchmark.protocol import Protocol
from benchmark.record_columns import to_columns, to_rows
from benchmark.results import read_result, result_path, write_result


def test_a_cell_in_several_pieces_reads_as_the_same_episodes(make_result, tmp_path):
    result = make_result(protocol=Protocol(episodes=3, levels=(0, 1)))
    pieces = replace(result, records=(*result.records[1:], result.records[0]))
    path = result_path(tmp_path, pieces)
    write_result(path, pieces)
    assert read_result(path) == pieces
    assert [len(cell["episode"]) for cell in to_columns(pieces.records)[0]] == [2, 3, 3, 3, 1]


def test_a_wording_may_be_a_whole_number_of_any_kind(make_result):
    records = [replace(record, instruction="lift") for record in make_result().records]
    cells, wordings = to_columns(records)
    rows = to_rows([cell | {"instruction": [0.0] * len(cell["episode"])} for cell in cells], wordings)
    assert [row["instruction"] for row in rows] == ["lift"] * len(records)
    assert rows == to_rows(cells, wordings)
