"""Every section of the paper that is cited exists, and is about what the sentence that cites it says."""

import re
from pathlib import Path
from typing import NamedTuple

import pytest
import yaml

ROOT = Path(__file__).parents[1]
SECTIONS = yaml.safe_load((ROOT / "tests" / "paper_sections.yaml").read_text(encoding="utf-8"))
FOLDERS = ("formctl", "envs", "algos", "baselines", "analysis", "conf", "docs")
FILES = sorted(
    path for folder in FOLDERS for ending in ("py", "yaml", "md") for path in (ROOT / folder).rglob(f"*.{ending}")
)

OTHER_WORKS = re.compile(r"(MADER|ICRA 2022|Huang et al\. 2023|Swarm-RL), Sec\.$")
"""What stands before a section that is not the paper's."""
CITED = re.compile(r"Sec\. ((?:[IVX]+(?:-[A-Z]\d?)?)(?:(?:, | and )[IVX]+(?:-[A-Z]\d?)?)*)")


class Citation(NamedTuple):
    """One section, and the lines around its citation."""

    place: str
    section: str
    around: str


def citations() -> list[Citation]:
    found = []
    for path in FILES:
        lines = path.read_text(encoding="utf-8").splitlines()
        for number, line in enumerate(lines):
            for match in CITED.finditer(line):
                if OTHER_WORKS.search(line[: match.start() + 4]):
                    continue
                around = " ".join(lines[max(0, number - 1) : number + 2])
                place = f"{path.relative_to(ROOT)}:{number + 1}"
                found += [Citation(place, section, around) for section in re.split(", | and ", match[1])]
    return found


def test_there_are_citations() -> None:
    assert len(citations()) > 40


@pytest.mark.parametrize("citation", citations(), ids=lambda citation: f"{citation.place} {citation.section}")
def test_a_cited_section_says_so(citation: Citation) -> None:
    assert citation.section in SECTIONS, f"{citation.place}: the paper has no section {citation.section}"
    words = SECTIONS[citation.section]["words"]
    assert any(word.lower() in citation.around.lower() for word in words), (
        f"{citation.place} cites {citation.section}, {SECTIONS[citation.section]['title']}"
    )


@pytest.mark.parametrize(
    ("text", "wrong"),
    [("the reward vector (paper, Sec. IV-A)", "IV-A"), ("the encoder (paper, Sec. III-B)", "III-B")],
)
def test_a_wrong_citation_would_be_seen(text: str, wrong: str) -> None:
    """The two ways to be wrong: a section that is not there, and one about something else."""
    known = SECTIONS.get(wrong)
    assert known is None or not any(word.lower() in text.lower() for word in known["words"])
