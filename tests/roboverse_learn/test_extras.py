"""Extras: what installs one, and what of it is missing."""

from roboverse_learn import extras


def test_an_extra_counts_as_installed_only_where_all_of_its_packages_are(monkeypatch):
    wanted = ["numpy>=2", "numpy; extra == 'one'", "numpy>=1; extra == 'two'", "no-such==1; extra == 'two'"]
    monkeypatch.setattr(extras.metadata, "requires", lambda _: wanted)
    assert extras.is_installed("one") and extras.missing_packages("one") == []
    assert not extras.is_installed("two") and extras.missing_packages("two") == ["no-such"]
    assert not extras.is_installed("three")
