"""Drawn episodes: what is drawn, that it is a pure function of the seed and index, and banks."""

import json

import numpy as np
import pytest
import torch

from envs import scenarios
from envs.bank import Bank, BankError
from tests.envs.conftest import make_world


def spec(*overrides):
    return make_world(*overrides).scenario


def test_episode_k_does_not_depend_on_how_many_are_drawn():
    few, many = (scenarios.sample(spec("scenario=mixed"), count, 5) for count in (3, 50))
    for small, large in zip(few, many, strict=True):
        torch.testing.assert_close(small, large[:3], rtol=0, atol=0)
    other = scenarios.sample(spec("scenario=mixed"), 3, 6)
    assert not torch.equal(few.columns, other.columns)


def test_columns_stand_on_the_zigzag_grid_without_repeats():
    columns = scenarios.sample(spec("scenario=static", "scenario.columns=20"), 400, 1, dtype=torch.float64).columns
    x, y = columns.unbind(-1)
    row = ((y - 2) / 0.5).round()
    assert y.min() == 2.0
    assert y.max() == 33.5
    torch.testing.assert_close(y, 2 + 0.5 * row)
    even = row % 2 == 0
    assert set(x[even].unique().tolist()) == {-1.75, -1.25, -0.75, -0.25, 0.25, 0.75, 1.25, 1.75}
    assert set(x[~even].unique().tolist()) == {-1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5, 2.0}
    places = (100 * row + 4 * x).sort(-1).values
    assert (places.diff(dim=-1) > 0).all()


def test_columns_are_spread_over_all_rows_alike():
    columns = scenarios.sample(spec("scenario=static"), 4000, 2).columns
    counts = torch.bincount(((columns[..., 1].flatten() - 2) / 0.5).round().long(), minlength=64)
    expected = 4000 * 10 / 64
    assert ((counts - expected).square() / expected).sum() < 100  # chi-square, 63 degrees of freedom, p = 0.002


def test_more_columns_than_cells_says_how_many_fit():
    with pytest.raises(ValueError, match=r"at most scenario\.columns=512"):
        scenarios.sample(spec("scenario=static").__class__(**{**spec().__dict__, "columns": 513}), 1, 0)


@pytest.mark.parametrize(("aim", "drones", "box"), [("drone", True, False), ("box", False, True), ("mix", True, True)])
def test_aims_follow_the_rule(aim, drones, box):
    aims = scenarios.sample(spec("scenario=mixed", f"scenario.ball_aim={aim}"), 200, 0).aim
    assert (aims >= 0).any().item() is drones
    assert (aims < 0).any().item() is box
    assert aims.max() <= 2


def test_throws_stay_in_their_ranges():
    throws = scenarios.sample(spec("scenario=dynamic"), 500, 0).throws
    torch.testing.assert_close(throws[..., :2].norm(dim=-1), torch.ones(500, 2, 4))
    for column, (low, high) in zip(range(2, 5), ((2, 5), (0.8, 1.6), (0.5, 1.5)), strict=True):
        assert low <= throws[..., column].min() < throws[..., column].max() <= high


def test_padding_changes_nothing_that_is_there():
    drawn = scenarios.sample(spec("scenario=mixed"), 4, 0)
    padded = scenarios.pad(drawn, 15, 5)
    torch.testing.assert_close(padded.columns[:, :10], drawn.columns)
    assert padded.throw_time[:, 2:].isinf().all()
    with pytest.raises(ValueError, match="cannot pad"):
        scenarios.pad(drawn, 5, 5)


def test_jitter_is_only_in_the_real_flights():
    assert scenarios.sample(spec("scenario=mixed"), 2, 0).attitude[..., 0].min() == 1
    real = scenarios.sample(spec("scenario=real_mixed"), 200, 0, dtype=torch.float64)
    moved = real.position - real.position.mean(0)
    assert 0.04 < moved.abs().max() < 0.06
    torch.testing.assert_close(real.attitude.norm(dim=-1), torch.ones(200, 3, dtype=torch.float64), rtol=0, atol=2e-7)


def test_bank_round_trip_and_hash(tmp_path):
    bank = Bank.create(spec("scenario=mixed"), 20, 7)
    bank.save(tmp_path / "bank.npz")
    again = Bank.load(tmp_path / "bank.npz")
    assert (again.sha256, again.seed, again.spec) == (bank.sha256, 7, bank.spec)
    for left, right in zip(bank.scenarios, again.scenarios, strict=True):
        torch.testing.assert_close(left, right, rtol=0, atol=0)
    assert Bank.create(spec("scenario=mixed"), 20, 7).sha256 == bank.sha256
    assert Bank.create(spec("scenario=mixed"), 20, 8).sha256 != bank.sha256


@pytest.mark.parametrize(("scenario", "digits"), [("mixed", "f79e0a850cfb"), ("real_mixed", "982370a3baa1")])
def test_a_bank_has_the_same_hash_on_every_processor(scenario, digits, monkeypatch):
    assert Bank.create(spec(f"scenario={scenario}"), 1000, 1000).sha256.startswith(digits)
    exact = scenarios.rotation.norm  # another library: every other square root is one unit in the last place larger
    above = torch.tensor(torch.inf, dtype=torch.float64)

    def norm(vector, keepdim=False):
        length = exact(vector, keepdim)
        return torch.where((1e6 * length).sin() > 0, torch.nextafter(length, above), length)

    monkeypatch.setattr(scenarios.rotation, "norm", norm)
    assert Bank.create(spec(f"scenario={scenario}"), 1000, 1000).sha256.startswith(digits)


def test_bad_banks_are_refused_in_one_line(tmp_path):
    path = tmp_path / "bank.npz"
    with pytest.raises(BankError, match="no bank at"):
        Bank.load(path)
    path.write_bytes(b"not a bank")
    with pytest.raises(BankError, match="is not a scenario bank"):
        Bank.load(path)
    Bank.create(spec("scenario=mixed"), 5, 7).save(path)
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(BankError, match="damaged"):
        Bank.load(path)


def test_changed_bank_is_refused(tmp_path):
    path = tmp_path / "bank.npz"
    Bank.create(spec("scenario=mixed"), 5, 7).save(path)
    with np.load(path) as archive:
        arrays = dict(archive)
    arrays["columns"] = arrays["columns"] + 0.1
    np.savez(path, **arrays)
    with pytest.raises(BankError, match="does not match its own hash"):
        Bank.load(path)
    header = json.loads(str(arrays["header"]))
    assert header["seed"] == 7
