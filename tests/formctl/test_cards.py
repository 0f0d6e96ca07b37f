"""Model cards: one ships with each policy and belongs to it; a card of one's own says what the store has."""

import re
from pathlib import Path

import pytest

from formctl import cards
from formctl.evaluation import methods


@pytest.mark.parametrize("name", methods.shipped())
def test_every_shipped_policy_has_its_own_card(name: str) -> None:
    policy = methods.shipped()[name]
    text = cards.shipped_card(policy).read_text()
    again = f"make it anew: formctl card {name} --runs runs/reference --out formctl/policies/{name}.md"
    assert cards.file_digest(policy) in text, again
    for heading in ("Task", "Training", "What was measured", "Limits", "How to use it"):
        assert f"\n## {heading}\n" in text
    rates = re.findall(r"\| (0\.\d{3}|1\.000) \[", text)
    assert len(rates) >= 5, again


def test_a_shipped_card_is_printed_as_it_is(call) -> None:
    answer = call("card", "mixed")
    assert answer.code == 0
    assert answer.out == cards.shipped_card(methods.shipped()["mixed"]).read_text()


def test_a_card_of_one_s_own_says_what_the_store_has(stocked: Path, tiny: list[str], call, tmp_path: Path) -> None:
    store = f"runs={stocked}"
    empty = call("card", "ours", "--runs", str(stocked))
    assert empty.code == 0 and "Nothing in the store" in empty.out
    few = call("eval", "--policy", "ours", "eval.episodes=100", *[w for w in tiny if "eval.episodes" not in w], store)
    assert few.code == 0, few.err
    out = tmp_path / "card.md"
    assert call("card", "ours", "--runs", str(stocked), "--out", str(out)).code == 0
    assert "| mixed: 10 columns, 2 balls at the drone | torch, crazyflie" in out.read_text()
    assert "| 100 | 0.000 [0.000, 0.037] |" in out.read_text()


def test_what_is_no_policy_is_refused_in_one_line(call) -> None:
    answer = call("card", "nothing")
    assert answer.code == 2 and "shipped with formctl: mixed" in answer.line
