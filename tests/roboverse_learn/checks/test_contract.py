"""Choosing contracts, and what is found where one is kept, broken, or does not apply."""

import pytest

from envs.core.errors import ConfigError, MissingExtraError, UnknownNameError
from roboverse_learn.checks.contract import Finding, NotApplicableError, chosen, contract, require, run
from roboverse_learn.checks.report import Checked


@contract()
def first(number):
    """It is a number.

    More about it.
    """
    return f"{number + 0}"


@contract("first")
def small(number):
    """It is small."""
    require(number < 10, f"{number} is too large. Take one digit.")
    return "small"


@contract("small")
def even(number):
    """It is even."""
    if number == 1:
        raise NotApplicableError("1 is no matter")
    return "even"


ALL = (first, small, even)


def results(number, contracts=ALL):
    return [(finding.name, finding.result, finding.detail) for finding in run(contracts, number)]


def test_name_and_line_are_those_of_the_function():
    assert (first.name, first.about, small.needs) == ("first", "It is a number.", ("first",))


def test_what_was_seen_or_why_it_was_skipped_is_said():
    assert results(1) == [
        ("first", "ok", "1"),
        ("small", "ok", "small"),
        ("even", "skipped", "1 is no matter"),
    ]


def test_what_needs_a_broken_contract_is_skipped():
    assert results(12)[1:] == [
        ("small", "failed", "12 is too large. Take one digit."),
        ("even", "skipped", "needs 'small'"),
    ]


def test_an_error_of_the_authors_code_is_found_with_its_line():
    (_, result, detail), *others = results("three")
    assert result == "failed"
    assert detail.startswith("TypeError: can only concatenate str")
    assert "test_contract.py:" in detail and detail.endswith(", in first)")
    assert [finding[1] for finding in others] == ["skipped", "skipped"]


def test_our_own_errors_are_found_without_a_line_and_a_missing_package_is_no_finding():
    @contract()
    def broken(error):
        raise error

    assert results(ConfigError("Say it."), [broken]) == [("broken", "failed", "Say it.")]
    with pytest.raises(MissingExtraError):
        results(MissingExtraError("Install it."), [broken])


def test_chosen_contracts_come_with_what_they_need_in_order():
    assert [each.name for each in chosen(ALL, ["even"])] == ["first", "small", "even"]
    assert [each.name for each in chosen(ALL, (), ["small"])] == ["first", "even"]
    assert chosen(ALL) == list(ALL)


@pytest.mark.parametrize("choice", [(["smal"], []), ([], ["smal"])])
def test_an_unknown_contract_suggests_the_nearest(choice):
    with pytest.raises(
        UnknownNameError, match=r"Unknown contract 'smal'. Did you mean 'small'\? Valid: even"
    ):
        chosen(ALL, *choice)


def test_a_report_is_ok_unless_one_failed():
    findings = [Finding("first", "ok", "1"), Finding("small", "skipped", "no")]
    assert Checked(what="it", contracts=ALL[:2], findings=findings).ok
    findings[1] = Finding("small", "failed", "mend it")
    assert not Checked(what="it", contracts=ALL[:2], findings=findings).ok
