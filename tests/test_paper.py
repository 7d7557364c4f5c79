"""What the paper on the package says, as far as a test can hold it."""

import re
from pathlib import Path

import pytest

from atlas import extension, systems

TEXT = (Path(__file__).parents[1] / "docs" / "paper" / "paper.md").read_text()


@pytest.mark.extension("yehia2021")
@pytest.mark.extension("amer2013")
def test_the_paper_has_the_sections_of_its_journal_and_the_counts_of_the_errata():
    assert re.findall(r"^# (.+)$", TEXT, re.MULTILINE) == [
        "Summary", "Statement of need", "State of the field", "Software design", "Research impact statement",
        "AI usage disclosure", "Acknowledgements", "References",
    ]  # fmt: skip
    words = " ".join(re.sub(r"<!--.*?<!-- end -->", "", TEXT, flags=re.DOTALL).split())
    assert 750 <= len(words.split()) <= 1750  # what the journal allows
    counts = re.search(
        r"Of (\d+) equations and statements of @yehia2021, (\d+) need .* (\d+) of (\d+) of @amer2013", words
    )
    rows = {
        name: [row.verdict for part in extension.of_each("published", name) for row in part]
        for name in systems.BUILT_IN
    }
    differ = {name: len(each) - each.count("true") for name, each in rows.items()}
    assert [int(number) for number in counts.groups()] == [
        len(rows["satellite"]), differ["satellite"], differ["fixed_point"], len(rows["fixed_point"]),
    ]  # fmt: skip


def test_both_systems_have_the_dissipation_that_the_paper_names():
    assert "the dissipation of both systems is a viscous torque" in " ".join(TEXT.split())
    assert all("damping" in systems.get(name).parameters for name in systems.BUILT_IN)
